"""The tissue on finite elements: any `StressLaw` below, explicit or implicit in time, or at rest.

Reading order: settings; elements (space); forces, free_sides, outer_sides (that meet), mass,
system (what acts on it);
equations_of_motion, time_stepping (explicit), generalised_alpha (implicit); audits (of a law, on
the way), history, simulation (a run). Without time: rest, answer_error (of a rest by a cache),
modes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.macro.elements import points_by_region
    from surrofe2.macro.history import Frames, MacroState, MetRange
    from surrofe2.macro.modes import Modes, find_modes
    from surrofe2.macro.rest import Rest, find_rest
    from surrofe2.macro.settings import MacroSettings
    from surrofe2.macro.simulation import MacroRun, simulate

__getattr__, __dir__ = public_names(__name__)
