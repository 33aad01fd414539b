"""Item 5: everything but the stress law in a right-hand side, with a law that costs nothing."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.row import Row
from benchmarks.setting import Array, Setting
from benchmarks.timing import ratio, side_by_side, threads
from surrofe2 import LoadCase
from surrofe2.law.stress_law import Acceptance, StressResponse
from surrofe2.macro.discretisation import Discretisation
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.internal_force import deformation_gradient, internal_force
from surrofe2.macro.system import System, make_system

TITLE = "A right-hand side but for its stress law"
DENSITY = 0.08


class ReadyLaw:
    """The same answer to every question, made beforehand."""

    density, has_tangents = DENSITY, False

    def __init__(self, points: int) -> None:
        stress = np.random.default_rng(0).uniform(-1.0, 1.0, (points, 2, 2))
        self._answer = StressResponse(stress, np.zeros(points, dtype=np.int8))

    def respond(
        self, F: Array, F_dot: Array, state: None = None, *, tangents: bool = False
    ) -> StressResponse:
        """The ready answer."""
        return self._answer

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """As it is."""
        return Acceptance(response.status)


def run(setting: Setting) -> list[Row]:
    """4 × 4 elements in µs, 64 × 64 in µs a point."""
    with threads(1):
        return [
            _overhead(setting, 4, "a right-hand side", 80.0, per_point=False),
            _overhead(setting, 64, "a right-hand side, a point", 0.2, per_point=True),
        ]


def _overhead(setting: Setting, n: int, name: str, limit: float, *, per_point: bool) -> Row:
    system = make_system(LoadCase(elements=(n, n)), DENSITY)
    points = system.discretisation.n_points
    law = ReadyLaw(points)
    equations = EquationsOfMotion(system, law)
    y = 1e-3 * np.random.default_rng(1).uniform(-1.0, 1.0, 2 * system.free.size)
    load = system.forces[0].at(0.0, equations.within, *system.spread(y, 0.0, equations.within))
    ours, plain = side_by_side(
        [partial(equations.evaluate, 0.0, y), partial(_plainly, system, law, load, y)],
        setting.pick(25, 7),
    )
    scale = 1e6 / (points if per_point else 1)
    return Row(
        name=f"{n} × {n} elements: {name}",
        value=ours.median * scale,
        spread=ours.spread * scale,
        unit="µs",
        limit=limit,
        baseline="the same in numpy: einsum and add.at (mass solve shared)",
        baseline_value=plain.median * scale,
        ratio=ratio(plain, ours),
        error=_distance(system, law, y),
        error_of="largest difference of the internal force from numpy's / its largest",
    )


def _distance(system: System, law: ReadyLaw, y: Array) -> float:
    space = system.discretisation
    F, F_dot, _ = deformation_gradient(space, *system.spread(y, 0.0, 0.0))
    stress = law.respond(F, F_dot).stress
    expected = _force_plainly(space, F, stress)
    return float(abs(internal_force(space, F, stress) - expected).max() / abs(expected).max())


def _plainly(system: System, law: ReadyLaw, load: Array, y: Array) -> Array:
    space, identity = system.discretisation, np.eye(2)
    F, F_dot = (
        np.einsum("eai,eqaj->eqij", field[space.elements], space.gradients)
        for field in system.spread(y, 0.0, 0.0)
    )
    F = (F + identity).reshape(-1, 2, 2)
    stress = law.respond(F, F_dot.reshape(-1, 2, 2)).stress
    acceleration = system.solve_mass(system.pick(load - _force_plainly(space, F, stress)))
    return np.concatenate([y[y.size // 2 :], acceleration])


def _force_plainly(space: Discretisation, F: Array, stress: Array) -> Array:
    """Σ J w σ F⁻ᵀ ∇N with the deviator at the Gauss points and the pressure at the centre."""
    J = np.linalg.det(F)
    slopes = np.linalg.inv(F).swapaxes(1, 2)
    pressure = 0.5 * np.trace(stress, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    n_q = space.points_per_element
    gauss: NDArray[np.bool_] = np.arange(len(F)) % n_q < n_q - 1
    part = np.where(gauss[:, None, None], stress - pressure, pressure)
    nominal = (part @ slopes * J[:, None, None]).reshape(-1, n_q, 2, 2)
    by_node = np.einsum("eq,eqij,eqaj->eai", space.weights, nominal, space.gradients, optimize=True)
    force = np.zeros_like(space.nodes)
    np.add.at(force, space.elements, by_node)
    return force
