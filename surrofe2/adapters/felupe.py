"""A stress law as the material of FElupe's `SolidBody`, in the plane, at rest or in motion.

FElupe gives F at all points at once and keeps a state of each from substep to substep. Over a
substep of `dt` the rate at its end is that of backward differences, or in motion Newmark's, which
`Inertia` has too (Weights of `surrofe2.macro.generalised_alpha`)::

    Ḟ = (F − F₀)/h                                                       quasi-static
    Ḟ = (γ/βh)(F − F₀) + (1 − γ/β) Ḟ₀ + h (1 − γ/2β) F̈₀                 in motion
    ∂P/∂F (whole) = ∂P/∂F + (1/h or γ/βh) ∂P/∂Ḟ

With `dt` infinite, as it is at first, the material is at rest: quasi-static without rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from surrofe2.errors import InputError, SimulationError
from surrofe2.macro.generalised_alpha import Weights
from surrofe2.stress_law import StressLaw, StressResponse, describe
from surrofe2.tensors import cofactor

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Newmark:
    """Rates of what moves from x₀ to x within h; of displacements as of F."""

    weights: Weights
    h: float

    def acceleration(self, gain: Array, v: Array, a: Array) -> Array:
        """At the end, from x − x₀ and velocity and acceleration at the begin."""
        beta, h = self.weights.beta, self.h
        return (gain - h * v) / (beta * h**2) - (0.5 / beta - 1.0) * a

    def velocity(self, v: Array, a: Array, a_end: Array) -> Array:
        """At the end."""
        gamma = self.weights.gamma
        return v + self.h * ((1.0 - gamma) * a + gamma * a_end)

    @property
    def slope(self) -> float:
        """Of the velocity at the end by x."""
        return self.weights.gamma / (self.weights.beta * self.h)


class FelupeMaterial:
    """`umat` of `felupe.SolidBody(umat, field)` for fields in the plane.

    A material belongs to one body, for it keeps warm starts of its points.

    Args:
        law: gives stress and tangents; RVEs, a surrogate, or a law of one's own.
        spectral_radius: that of the body's `Inertia`; None: the body is quasi-static.

    Attributes:
        dt: length of the substep, µs. `Substeps` sets it.
        x: shapes of F and of the state, as FElupe asks for them: F − 1, in motion with Ḟ and F̈.

    Raises:
        InputError: the law has no tangents.
    """

    def __init__(self, law: StressLaw, spectral_radius: float | None = None) -> None:
        if not law.has_tangents:
            raise InputError("law: it has no tangents, which FElupe's Newton method needs")
        self.law, self.dt = law, np.inf
        self.weights = None if spectral_radius is None else _weights(spectral_radius)
        self.x: list[Array] = [np.eye(2), np.zeros(4 if self.weights is None else 12)]
        self._state: Any = None

    def gradient(self, x: Sequence[Array]) -> list[Array]:
        """[P (2, 2, q, c) in µN/µm, the state at the end of the substep (4 or 12, q, c)]."""
        F, after, answer, _ = self._answer(x)
        P = answer.stress @ cofactor(F)
        trailing = x[0].shape[2:]
        return [_last(P, trailing), _last(after, trailing)]

    def hessian(self, x: Sequence[Array]) -> list[Array]:
        """[∂P/∂F (2, 2, 2, 2, q, c) over the substep, µN/µm]."""
        _, _, answer, slope = self._answer(x, tangents=True)
        assert answer.tangents is not None
        whole = answer.tangents.P_by_F + slope * answer.tangents.P_by_F_dot
        return [_last(whole, x[0].shape[2:])]

    def _answer(
        self, x: Sequence[Array], *, tangents: bool = False
    ) -> tuple[Array, Array, StressResponse, float]:
        """F (n, 2, 2), the state after (n, k), the law's answer and ∂Ḟ/∂F."""
        F, before = _first(x[0], (2, 2)), _first(x[-1], self.x[-1].shape)
        gain = F.reshape(-1, 4) - np.eye(2).ravel() - before[:, :4]
        parts, slope = [F.reshape(-1, 4) - np.eye(2).ravel()], 1.0 / self.dt
        F_dot = gain / self.dt
        if self.weights is not None and np.isfinite(self.dt):
            newmark = _Newmark(self.weights, self.dt)
            v, a = before[:, 4:8], before[:, 8:]
            a_end = newmark.acceleration(gain, v, a)
            F_dot, slope = newmark.velocity(v, a, a_end), newmark.slope
            parts += [F_dot, a_end]
        after = np.zeros(before.shape)
        after[:, : 4 * len(parts)] = np.concatenate(parts, axis=1)
        rate = np.ascontiguousarray(F_dot).reshape(-1, 2, 2)
        answer = self.law.respond(F, rate, self._state, tangents=tangents)
        failed = np.flatnonzero(answer.status)
        if failed.size:
            why = describe(answer.status[failed[0]])
            raise SimulationError(f"point {failed[0]} of {len(F)}: {why}")
        self._state = answer.state
        return F, after, answer, slope


class Inertia:
    """An item of `felupe.Step`: mass times acceleration by the generalised-α of `surrofe2.macro`.

    With what all other forces leave at the begin, r₀, and the algorithmic accelerations a₀ and a,
    they leave r = [(1 − α_m) M a + α_m M a₀ − α_f r₀]/(1 − α_f) at the end. The body begins at
    rest and in balance, so loads rise from what it rests under. Steps are of one length: after a
    change the method is of first order for a step.

    Args:
        mass: sparse (m, m) of all unknowns of the field, ng, as FElupe's
            `SolidBody.assemble.mass(law.density)` gives it.
        field: the body's field container.
        spectral_radius: amplification a step of infinitely fast modes, as in `MacroSettings`.

    Attributes:
        dt: length of the substep, µs. `Substeps` sets it.
        velocity, acceleration: (m,) at the end of the last substep, µm/µs and µm/µs².
        assemble, results: itself, where FElupe looks for vector, matrix and update_statevars.
    """

    multiplier = None

    def __init__(self, mass: Any, field: Any, spectral_radius: float = 0.9) -> None:
        self.weights, self.dt, self.field = _weights(spectral_radius), np.inf, field
        self._mass = csr_matrix(mass)
        self._u = field[0].values.ravel().copy()
        if self._mass.shape != (self._u.size,) * 2:
            raise InputError(
                f"mass: shape {self._mass.shape}; it must be that of the field's unknowns, "
                f"{(self._u.size,) * 2}"
            )
        self.velocity, self.acceleration, self._left = np.zeros((3, self._u.size))

    @property
    def assemble(self) -> Self:
        """Itself."""
        return self

    @property
    def results(self) -> Self:
        """Itself."""
        return self

    def vector(self, field: Any = None, **_: Any) -> Any:
        """(m, 1) sparse force, µN."""
        if field is not None:
            self.field = field
        return csr_matrix(self._force(self._acceleration_now()).reshape(-1, 1))

    def matrix(self, field: Any = None, **_: Any) -> Any:
        """(m, m) sparse slope of the force by the displacement, µN/µm."""
        w, h = self.weights, self._newmark().h
        factor = (1.0 - w.alpha_m) / ((1.0 - w.alpha_f) * w.beta * h**2)
        return factor * self._mass

    def update_statevars(self) -> None:
        """Called by FElupe where a substep has converged."""
        a = self._acceleration_now()
        self._left = self._force(a)
        self.velocity = self._newmark().velocity(self.velocity, self.acceleration, a)
        self.acceleration, self._u = a, self.field[0].values.ravel().copy()

    def _newmark(self) -> _Newmark:
        if not np.isfinite(self.dt):
            raise InputError("dt: infinite; give the inertia to Substeps, too")
        return _Newmark(self.weights, self.dt)

    def _acceleration_now(self) -> Array:
        gain = self.field[0].values.ravel() - self._u
        return self._newmark().acceleration(gain, self.velocity, self.acceleration)

    def _force(self, a: Array) -> Array:
        w = self.weights
        inertia = self._mass @ ((1.0 - w.alpha_m) * a + w.alpha_m * self.acceleration)
        return (inertia - w.alpha_f * self._left) / (1.0 - w.alpha_f)


class _Timed(Protocol):
    """What has a length of substeps."""

    dt: float


class Substeps:
    """A plugin of `felupe.Job` that gives materials and inertia the length of each substep.

    Args:
        times: µs, of the begin and of the end of every substep of the job.
    """

    def __init__(self, times: Sequence[float], *timed: _Timed) -> None:
        steps = np.diff(times)
        if not len(steps) or not (steps > 0.0).all():
            raise InputError("times: they must rise, from the begin of the job on")
        self._steps, self._timed, self._done = steps, timed, 0

    def before_substep(self, context: Any, state: Any) -> None:
        """Called by FElupe before it solves a substep."""
        if self._done == len(self._steps):
            raise InputError(f"times: {self._done + 1} of them, but the job has more substeps")
        for each in self._timed:
            each.dt = float(self._steps[self._done])
        self._done += 1


def _weights(spectral_radius: float) -> Weights:
    if not 0.0 <= spectral_radius <= 1.0:
        raise InputError(f"spectral_radius: {spectral_radius}; it must be within [0, 1]")
    return Weights.of(spectral_radius)


def _first(values: Array, shape: tuple[int, ...]) -> Array:
    """(n, …) from (…, q, c)."""
    return np.ascontiguousarray(np.moveaxis(values.reshape(*shape, -1), -1, 0))


def _last(values: Array, trailing: tuple[int, ...]) -> Array:
    """(…, q, c) from (n, …)."""
    moved = np.moveaxis(values, 0, -1)
    return np.ascontiguousarray(moved.reshape(*moved.shape[:-1], *trailing))
