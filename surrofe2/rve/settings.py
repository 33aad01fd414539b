"""How an RVE is put into the state it would have inside a tissue."""

from __future__ import annotations

from dataclasses import dataclass, field

from surrofe2.errors import InputError
from surrofe2.units import FORCE, NONE, TIME

INITIALISATIONS = ("cauchy-born", "elastic", "constrained-runs", "slow-manifold")
SOLVERS = ("direct", "iterated")


@dataclass(frozen=True, slots=True, kw_only=True)
class RveSettings:
    """Initialisation and solver of the micro problem.

    Attributes:
        initialisation: "cauchy-born" (eq. 64), "elastic" (eqs. 65 to 67), "constrained-runs"
            (eqs. 69 to 72) or "slow-manifold" (docs/theory.md, not in the paper).
        solver: "direct" (Newton on the fixed point) or "iterated" (the paper's Euler step and
            rescaling; for "elastic" with the velocities of the macro scale at zero).
        tolerance: mean particle force at which `direct` stops, µN.
        stop: mean particle force at which `iterated` stops, µN (paper: 1.0, section 6.2).
        micro_step: time step of `iterated`, µs (paper: 1e-4).
        max_iterations: steps after which `iterated` gives up.
    """

    initialisation: str = field(
        default="constrained-runs", metadata={"unit": NONE, "about": ", ".join(INITIALISATIONS)}
    )
    solver: str = field(default="direct", metadata={"unit": NONE, "about": ", ".join(SOLVERS)})
    tolerance: float = field(
        default=1e-8, metadata={"unit": FORCE, "about": "mean particle force, solver direct"}
    )
    stop: float = field(
        default=1.0, metadata={"unit": FORCE, "about": "mean particle force, solver iterated"}
    )
    micro_step: float = field(
        default=1e-4, metadata={"unit": TIME, "about": "Euler step, solver iterated"}
    )
    max_iterations: int = field(
        default=1_000_000, metadata={"unit": NONE, "about": "limit of solver iterated"}
    )

    def __post_init__(self) -> None:
        for name, allowed in (("initialisation", INITIALISATIONS), ("solver", SOLVERS)):
            value = getattr(self, name)
            if value not in allowed:
                raise InputError(f"rve.{name}: {value!r}; it must be one of {', '.join(allowed)}")
        if (self.initialisation, self.solver) == ("slow-manifold", "iterated"):
            raise InputError(
                "rve.solver: 'iterated'; with initialisation slow-manifold it must be direct"
            )
        for name in ("tolerance", "stop", "micro_step", "max_iterations"):
            value = getattr(self, name)
            if not 0.0 < value < float("inf"):
                raise InputError(f"rve.{name}: {value}; it must be positive and finite")
