"""Item 5: everything but the stress law in a right-hand side, with a law that costs nothing."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.row import Row
from benchmarks.setting import Array, Setting
from benchmarks.timing import ratio, side_by_side, threads
from surrofe2 import LoadCase
from surrofe2.macro.discretisation import (
    N_GAUSS,
    N_POINTS,
    Discretisation,
    make_discretisation,
)
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.internal_force import deformation_gradient, internal_force
from surrofe2.stress_law import Acceptance, StressResponse

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
    load = LoadCase()
    bar = make_discretisation(load, (n, n), DENSITY)
    law = ReadyLaw(bar.n_points)
    equations = EquationsOfMotion(bar, law, load.amplitude_at)
    y = 1e-3 * np.random.default_rng(1).uniform(-1.0, 1.0, 4 * len(bar.free))
    ours, plain = side_by_side(
        [partial(equations.evaluate, 0.0, y), partial(_plainly, bar, law, y)], setting.pick(25, 7)
    )
    scale = 1e6 / (bar.n_points if per_point else 1)
    return Row(
        name=f"{n} × {n} elements: {name}",
        value=ours.median * scale,
        spread=ours.spread * scale,
        unit="µs",
        limit=limit,
        baseline="the same in numpy: einsum and add.at (mass solve shared)",
        baseline_value=plain.median * scale,
        ratio=ratio(plain, ours),
        error=_distance(bar, law, y),
        error_of="largest difference of the internal force from numpy's / its largest",
    )


def _distance(bar: Discretisation, law: ReadyLaw, y: Array) -> float:
    u, v = y.reshape(2, -1, 2)
    F, F_dot, _ = deformation_gradient(bar, u, v)
    stress = law.respond(F, F_dot).stress
    expected = _force_plainly(bar, F, stress)
    return float(abs(internal_force(bar, F, stress) - expected).max() / abs(expected).max())


def _plainly(bar: Discretisation, law: ReadyLaw, y: Array) -> Array:
    u, v = y.reshape(2, -1, 2)
    identity = np.eye(2)
    F, F_dot = (
        np.einsum("eai,eqaj->eqij", bar.on_all_nodes(field)[bar.quads], bar.gradients)
        for field in (u, v)
    )
    F = (F + identity).reshape(-1, 2, 2)
    stress = law.respond(F, F_dot.reshape(-1, 2, 2)).stress
    acceleration = bar.inverse_mass @ (bar.load - _force_plainly(bar, F, stress))
    return np.concatenate([v.ravel(), acceleration.ravel()])


def _force_plainly(bar: Discretisation, F: Array, stress: Array) -> Array:
    """Σ J w σ F⁻ᵀ ∇N with the deviator at the Gauss points and the pressure at the centre."""
    J = np.linalg.det(F)
    slopes = np.linalg.inv(F).swapaxes(1, 2)
    pressure = 0.5 * np.trace(stress, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    gauss: NDArray[np.bool_] = np.arange(len(F)) % N_POINTS < N_GAUSS
    part = np.where(gauss[:, None, None], stress - pressure, pressure)
    nominal = (part @ slopes * J[:, None, None]).reshape(-1, N_POINTS, 2, 2)
    by_node = np.einsum("eq,eqij,eqaj->eai", bar.weights, nominal, bar.gradients, optimize=True)
    force = np.zeros_like(bar.nodes)
    np.add.at(force, bar.quads, by_node)
    return force[bar.free]
