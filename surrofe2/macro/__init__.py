"""The bar on finite elements: any `StressLaw` below, Dormand–Prince 5(4) in time.

Reading order: mesh, selective_quadrature, internal_force (space); right_hand_side,
time_integration (time); recording, results, simulation (a run). With a law's tangents:
tangent_assembly; generalised_alpha, implicit (time); quasi_static, modes (no time).
"""

from surrofe2.macro.modes import Modes, find_modes
from surrofe2.macro.quasi_static import Rest, find_rest
from surrofe2.macro.results import Frames, MacroRun, MetRange, rest_frames
from surrofe2.macro.settings import MacroSettings
from surrofe2.macro.simulation import simulate
from surrofe2.macro.state import MacroState

__all__ = [
    "Frames",
    "MacroRun",
    "MacroSettings",
    "MacroState",
    "MetRange",
    "Modes",
    "Rest",
    "find_modes",
    "find_rest",
    "rest_frames",
    "simulate",
]
