"""Settings by which an RVE is put into the state that it would have inside a tissue."""

from __future__ import annotations

from dataclasses import dataclass

from surrofe2.base.errors import InputError
from surrofe2.base.settings import check_settings, setting
from surrofe2.base.units import FORCE, TIME

# in the order of the paper, (64) to (72), and ours, which is not in it
INITIALISATIONS = ("cauchy-born", "elastic", "constrained-runs", "slow-manifold")
SOLVERS = ("direct", "iterated")


@dataclass(frozen=True, slots=True, kw_only=True)
class RveSettings:
    """Initialisation and solver of the micro problem.

    The initialisation is "cauchy-born" (eq. 64), "elastic" (eqs. 65 to 67), "constrained-runs"
    (eqs. 69 to 72) or "slow-manifold" (docs/theory.md, not in the paper); the solver "direct"
    (Newton on the fixed point) or "iterated" (the paper's Euler step and rescaling; for "elastic"
    with the velocities of the macro scale at zero).
    """

    initialisation: str = setting(
        "constrained-runs", "how the RVE finds its state", one_of=INITIALISATIONS
    )
    solver: str = setting("direct", "how the micro problem is solved", one_of=SOLVERS)
    tolerance: float = setting(
        1e-8, "mean particle force at which solver direct stops", FORCE, above=0.0
    )
    stop: float = setting(
        1.0,
        "mean particle force at which solver iterated stops (paper: 1.0, section 6.2)",
        FORCE,
        above=0.0,
    )
    micro_step: float = setting(1e-4, "Euler step, solver iterated (paper: 1e-4)", TIME, above=0.0)
    max_iterations: int = setting(1_000_000, "most iterations, solver iterated", least=1)

    def __post_init__(self) -> None:
        check_settings(self, "rve")
        # the iteration has no Jacobian, by which alone ∂x_el/∂F and so these velocities are known
        if (self.initialisation, self.solver) == ("slow-manifold", "iterated"):
            raise InputError(
                "rve.solver", "'iterated'; with initialisation slow-manifold it must be direct"
            )
