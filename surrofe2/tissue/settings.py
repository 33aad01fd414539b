"""Settings of a run of the full tissue, besides its problem and its plant cell."""

from __future__ import annotations

from dataclasses import dataclass

from surrofe2.base.settings import check_settings, setting
from surrofe2.base.units import FORCE, LENGTH, TIME


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueSettings:
    """Time step, accuracy of the unloaded equilibrium, and what is kept."""

    micro_step: float | None = setting(
        None,
        "longest leapfrog step; an output interval has a whole number of them; left out: 2e-3, or "
        "less where the cell's largest frequency and damping need it",
        TIME,
        above=0,
    )
    residual: float = setting(
        1e-6, "largest force left on a particle of the unloaded tissue", FORCE, above=0
    )
    skin: float = setting(
        2.0,
        "reach of neighbour lists beyond the cut-off; changes the cost only",
        LENGTH,
        above=0,
    )
    energy_steps: int = setting(
        50, "steps between two evaluations of the dissipated power, at most", least=1
    )
    frames: int = setting(51, "number of times at which particle fields are kept", least=2)

    def __post_init__(self) -> None:
        check_settings(self, "tissue")
