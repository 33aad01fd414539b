"""surrofe2: how soft, wet tissue deforms, from its cells upward.

In reading order, which is the order of the data:

    plant_cell   the particles of one plant cell: walls, contacts, fluid
    rve          (F, Ḟ) in, stress out, by a periodic sample of cells put into its state
    sampling     which (F, Ḟ) to ask; StressSamples, the answers
    surrogate    a small network trained on them
    cache        the surrogate where it may be trusted, the RVE elsewhere
    macro        a finite-element bar that asks any stress law at its quadrature points
    stress_law   the hinge between them: respond(F, F_dot) -> StressResponse

Units are µm, µs, ng throughout, see `surrofe2.units`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surrofe2.cache import CachedLaw
    from surrofe2.displacement_curve import DisplacementCurve
    from surrofe2.errors import Surrofe2Error
    from surrofe2.io.surrogates import read_surrogate, write_surrogate
    from surrofe2.load_case import LoadCase
    from surrofe2.macro import MacroRun, MacroSettings, simulate
    from surrofe2.plant_cell.parameters import CellParameters
    from surrofe2.rve import RveLaw
    from surrofe2.sampling import SamplingRange, sample
    from surrofe2.stress_law import Status, StressLaw, StressResponse
    from surrofe2.stress_samples import StressSamples
    from surrofe2.surrogate import SurrogateLaw, TrainingSettings, train

_HOME = {
    "CachedLaw": "cache",
    "CellParameters": "plant_cell.parameters",
    "DisplacementCurve": "displacement_curve",
    "LoadCase": "load_case",
    "MacroRun": "macro",
    "MacroSettings": "macro",
    "RveLaw": "rve",
    "SamplingRange": "sampling",
    "Status": "stress_law",
    "StressLaw": "stress_law",
    "StressResponse": "stress_law",
    "StressSamples": "stress_samples",
    "Surrofe2Error": "errors",
    "SurrogateLaw": "surrogate",
    "TrainingSettings": "surrogate",
    "read_surrogate": "io.surrogates",
    "sample": "sampling",
    "simulate": "macro",
    "train": "surrogate",
    "write_surrogate": "io.surrogates",
}

__all__ = [
    "CachedLaw",
    "CellParameters",
    "DisplacementCurve",
    "LoadCase",
    "MacroRun",
    "MacroSettings",
    "RveLaw",
    "SamplingRange",
    "Status",
    "StressLaw",
    "StressResponse",
    "StressSamples",
    "Surrofe2Error",
    "SurrogateLaw",
    "TrainingSettings",
    "read_surrogate",
    "sample",
    "simulate",
    "train",
    "write_surrogate",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for: `surrofe2 --help` needs no torch."""
    if name not in _HOME:
        raise AttributeError(f"module 'surrofe2' has no attribute {name!r}")
    return getattr(import_module(f"surrofe2.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
