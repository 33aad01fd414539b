"""RVEs as micro simulations of preCICE's Micro Manager 0.12, one for each point of the macro mesh.

preCICE knows vectors of the mesh's two dimensions, so tensors travel by rows::

    read     F-1, F-2, F-dot-1, F-dot-2         rows of F, and of Ḟ in 1/µs
    written  Stress-1, Stress-2                 rows of the Cauchy stress, µN/µm
             P-ab-by-F-c, P-ab-by-F-dot-c       ∂P_ab/∂F_c1, ∂P_ab/∂F_c2; a, b, c from 1 to 2

`SURROFE2_RECIPE` names the recipe, else it is recipe.toml in the working folder. Where
`SURROFE2_POINTS` names a folder, each output of the Micro Manager adds a line to the table of each
point there. With model switching, `surrofe2.adapters.micro_manager_surrogate` is the first model,
stateless, this module the second and the one with the switching function, which asks the bound of
the surrogate's error.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from micro_manager import MicroSimulationInterface
from numpy.typing import NDArray

from surrofe2.adapters.felupe import require_stress
from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError
from surrofe2.law.stress_law import (
    StressLaw,
    StressResponse,
    require_tangents,
    state_arrays,
    state_of,
)
from surrofe2.recipe.recipe import Recipe, load_recipe
from surrofe2.rve import RveLaw
from surrofe2.surrogate import SurrogateLaw
from surrofe2.workflow.laws import choose_law, true_law

# Environment variables, see the head of the file.
RECIPE = "SURROFE2_RECIPE"
POINTS = "SURROFE2_POINTS"
_ROWS = (1, 2)
_HEADER = [f"{name}_{a}{b}" for name in ("F", "F_dot", "stress") for a in _ROWS for b in _ROWS]


@cache
def the_recipe() -> Recipe:
    """Return the recipe of this process."""
    return load_recipe(os.environ.get(RECIPE, "recipe.toml"))


@cache
def the_rve() -> RveLaw:
    """Return the RVEs of this process."""
    law = true_law(the_recipe().study())
    require_tangents(law, "micro_manager")
    return law


@cache
def the_surrogate() -> SurrogateLaw:
    """Return the surrogate of this process."""
    law = choose_law(the_recipe().study(), "surrogate").law
    assert isinstance(law, SurrogateLaw)
    return law


@cache
def the_bound() -> SurrogateLaw:
    """Return the surrogate with the tolerances of the cache."""
    settings = the_recipe().cache
    return the_surrogate().with_tolerance(settings.tolerance, settings.relative)


class PointSimulation(MicroSimulationInterface):
    """A stress law with tangents at one point; a law without states may serve all points.

    What was solved is kept, by `accept`, when the next solve or a checkpoint comes, and forgotten
    when a checkpoint is put back: then the time window is solved again.
    """

    def __init__(self, sim_id: int, law: StressLaw) -> None:
        self._id = sim_id
        self._law = law
        self._state: Any = None
        self._solved: tuple[Array, Array, StressResponse] | None = None

    def initialize(self) -> dict[str, Array]:
        """Return what `solve` gives at rest, by name, with which adaptivity can begin."""
        F = np.eye(2)[None]
        answer = self._law.respond(F, 0.0 * F, tangents=True)
        require_stress(answer)
        return written(answer)

    def output(self) -> None:
        """Add F, Ḟ and stress at the end of the time window to the point's table, if wanted."""
        folder = os.environ.get(POINTS)
        if folder is None or self._solved is None:
            return
        F, F_dot, answer = self._solved
        path = Path(folder, f"point-{self._id}.csv")
        path.parent.mkdir(parents=True, exist_ok=True)
        values = np.concatenate([F.ravel(), F_dot.ravel(), answer.stress.ravel()])
        with path.open("a", encoding="utf-8") as file:
            if not file.tell():
                file.write(",".join(_HEADER) + "\n")
            file.write(",".join(f"{value:.17g}" for value in values) + "\n")

    def solve(self, micro_sim_input: Mapping[str, Any], dt: float) -> dict[str, Array]:
        """Compute stress and tangents by name from F and Ḟ by name.

        Raises:
            InputError: an entry is missing or no vector of the plane, or det F ≤ 0.
            SimulationError: the point has no stress.
        """
        F, F_dot = deformation_of(micro_sim_input)
        self._keep()
        answer = self._law.respond(F, F_dot, self._state, tangents=True)
        require_stress(answer)
        self._solved = (F, F_dot, answer)
        return written(answer)

    def get_state(self) -> dict[str, NDArray[Any]] | None:
        """Return arrays that another simulation of the same recipe may be given; None: at rest."""
        self._keep()
        return state_arrays(self._law, self._state) or None

    def set_state(self, state: Mapping[str, NDArray[Any]] | None) -> None:
        """Continue from what `get_state` gave."""
        self._solved = None
        self._state = state_of(self._law, state or {})

    def get_global_id(self) -> int:
        """Return the number among all simulations."""
        return self._id

    def set_global_id(self, global_id: int) -> None:
        """Become another number."""
        self._id = global_id

    def _keep(self) -> None:
        """Let the law commit the last solve, if there is one."""
        if self._solved is None:
            return
        F, F_dot, answer = self._solved
        accepted = self._law.accept(F, F_dot, answer)
        require_stress(accepted)
        self._state = accepted.state
        self._solved = None


class MicroSimulation(PointSimulation):
    """The RVE of one point."""

    def __init__(self, sim_id: int) -> None:
        super().__init__(sim_id, the_rve())


class Switching:
    """The switching function, which remembers in which window points went over to the RVE.

    Attributes:
        window: begin of the time window under way.
        switched: by location, the window in which the point went over to the RVE, NaN where it has
            not; of points that were asked for in this window or the last one.
    """

    def __init__(self) -> None:
        self.window = np.nan
        self.switched: dict[bytes, float] = {}
        self._last: dict[bytes, float] = {}

    def __call__(
        self, resolution: int, location: Any, t: float, input: Mapping[str, Any], prev_output: Any
    ) -> int:
        """Return +1 where a point goes over from the surrogate to the RVE, −1 back, else 0.

        It goes over where its risk, by the recipe's tolerance, exceeds 1; and back where it does
        not, but in a later time window, so that iterations converge. A point that comes from
        another rank as an RVE may have changed in this window.

        Args:
            resolution: 0 of the surrogate, 1 of the RVE.
            location: of the point.
            t: begin of the time window.
            input: F and Ḟ by name.
        """
        if t != self.window:
            self.window = t
            self._last = self.switched
            self.switched = {}
        key = np.asarray(location, dtype=np.float64).tobytes()
        if key not in self.switched:
            self.switched[key] = self._last.get(key, t if resolution == 1 else np.nan)
        status, _ = the_bound().status_and_risk(*deformation_of(input), 1.0)
        if resolution == 0 and status[0]:
            self.switched[key] = t
            return 1
        is_trusted_again = resolution == 1 and not status[0]
        if is_trusted_again and self.switched[key] != t:
            return -1
        return 0


switching_function = Switching()


def deformation_of(data: Mapping[str, Any]) -> tuple[Array, Array]:
    """Return F and Ḟ (1, 2, 2) from their rows by name."""
    F = np.array([[_vector(data, f"F-{row}") for row in _ROWS]])
    F_dot = np.array([[_vector(data, f"F-dot-{row}") for row in _ROWS]])
    return F, F_dot


def _vector(data: Mapping[str, Any], name: str) -> Array:
    """Return a vector of the plane by name, or raise an `InputError`."""
    if name not in data:
        known = ", ".join(map(str, data))
        raise InputError(f"read_data: {name} is missing among {known}; it must be a row of F or Ḟ")
    vector = np.asarray(data[name], dtype=np.float64)
    if vector.shape != (2,) or not np.isfinite(vector).all():
        raise InputError(f"{name}: {vector.tolist()}; it must be a finite vector of two components")
    return vector


def written(answer: StressResponse) -> dict[str, Array]:
    """Return stress and tangents of the only point by name."""
    tangents = answer.tangents
    assert tangents is not None
    data = {f"Stress-{a}": answer.stress[0, a - 1] for a in _ROWS}
    for name, slope in (("F", tangents.P_by_F), ("F-dot", tangents.P_by_F_dot)):
        for a, b, c in product(_ROWS, repeat=3):
            data[f"P-{a}{b}-by-{name}-{c}"] = slope[0, a - 1, b - 1, c - 1]
    return data
