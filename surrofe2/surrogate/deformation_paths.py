"""Paths of deformation in (F, Ḟ): what calibration exchanges, and the true stress along them.

A bound is believed on histories like those of a run, where neighbouring states share their error;
so a whole path counts once. Five kinds: random walks within a sampling range, single states of
it, of its corners and of small size, and runs of the macro scale, all of whose points together are
one path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from surrofe2.load_case import LoadCase
from surrofe2.sampling import SamplingRange
from surrofe2.stress_law import Acceptance, Status, StressLaw, StressResponse
from surrofe2.tensors import stress_error

Array = NDArray[np.float64]
State = tuple[Array, Array]

CHUNK = 512  # histories asked at once: true laws keep a warm start of each
_KNOTS = 8  # states that a walk passes through
_OUTER = 0.1  # of the half width: a corner
_SMALLEST = 1e-3  # of a state, among those of small size
_LEAST = 0.1  # of a component of these
_TURN = 0.5  # radians between two of them, at most
_LOAD_TIMES = 4
_LOAD_FACTOR = (0.25, 3.0)  # of the body force
_LONGEST_RUN = 50.0  # µs, about a period of the paper's bar
_SAME = 1e-6  # relative, and µN/µm: stresses of one equilibrium differ by less


@dataclass(frozen=True, slots=True)
class DeformationPaths:
    """Histories of (F, Ḟ), and which of them belong to one path.

    Attributes:
        kind: what they are, e.g. "walks".
        F, F_dot: (length, n, 2, 2) deformation gradient and its rate in 1/µs, in order of time.
        owner: (n,) number of the path that a history belongs to, from 0, none left out.
    """

    kind: str
    F: Array
    F_dot: Array
    owner: NDArray[np.intp]

    @property
    def count(self) -> int:
        """Number of paths."""
        return int(self.owner.max(initial=-1)) + 1

    @property
    def states(self) -> State:
        """F and F_dot of all states, (length n, 2, 2) each, contiguous."""
        return tuple(  # type: ignore[return-value]
            np.ascontiguousarray(tensors.reshape(-1, 2, 2)) for tensors in (self.F, self.F_dot)
        )

    def largest(self, values: Array) -> Array:
        """(count,) the largest of `values` (length n,) on each path."""
        worst = np.full(self.count, -np.inf)
        np.maximum.at(worst, self.owner, values.reshape(len(self.F), -1).max(axis=0))
        return worst


def random_states(range: SamplingRange, count: int, seed: int) -> DeformationPaths:
    """Paths of a single state each, independent and uniform over the range."""
    middle, half = _box(range)
    rng = np.random.default_rng(seed)
    U = _symmetric(middle + half * rng.uniform(-1.0, 1.0, (count, 3)))
    A = range.rate * rng.uniform(-1.0, 1.0, (count, 2, 2))
    return DeformationPaths("states", U[None], A[None], np.arange(count))


def random_corners(range: SamplingRange, count: int, seed: int) -> DeformationPaths:
    """Paths of a single state each, where U₁₁, U₂₂ and U₁₂ are all near a bound of the range.

    Each is within the outer tenth of its half width, on either side; RᵀḞ is uniform over the range
    in one half of the states, and near its bounds likewise in the other.
    """
    middle, half = _box(range)
    rng = np.random.default_rng(seed)

    def outer(*shape: int) -> Array:
        ends: Array = rng.choice([-1.0, 1.0], shape) * rng.uniform(1.0 - _OUTER, 1.0, shape)
        return ends

    U = _symmetric(middle + half * outer(count, 3))
    is_fast = rng.random((count, 1, 1)) < 0.5
    A = range.rate * np.where(is_fast, outer(count, 2, 2), rng.uniform(-1.0, 1.0, (count, 2, 2)))
    return DeformationPaths("corners", U[None], A[None], np.arange(count))


def random_small_states(range: SamplingRange, count: int, seed: int) -> DeformationPaths:
    """Paths of a single state each: random ones, drawn towards rest by factors.

    One is of the whole state, its logarithm uniform down to that of `_SMALLEST`, so that no size of
    load is left out. Others are of each component of U − I and RᵀḞ, down to `_LEAST`: a shear wave
    begins with its rate alone.
    """
    U, A = random_states(range, count, seed).states
    rng = np.random.default_rng([seed, 1])
    whole = _SMALLEST ** rng.uniform(0.0, 1.0, (count, 1, 1))
    stretch, rate = (_LEAST ** rng.uniform(0.0, 1.0, (count, *each)) for each in ((3,), (2, 2)))
    F = np.eye(2) + whole * _symmetric(stretch) * (U - np.eye(2))
    return DeformationPaths("small", F[None], (whole * rate * A)[None], np.arange(count))


def random_walks(range: SamplingRange, count: int, length: int, seed: int) -> DeformationPaths:
    """Smooth walks of F = R U with their own rates Ḟ = dF/dt, within the range throughout.

    U₁₁, U₂₂, U₁₂ and the angle of R run through random knots by monotone cubics, which stay
    between their knots; with J the turn by 90° and θ the angle of R, RᵀḞ = θ̇ J U + U̇. Each walk
    has its own centre, its own extent in each component and its own largest rate, uniform up to
    the range's. `length` states are taken at even times.
    """
    middle, half = _box(range)
    rng = np.random.default_rng(seed)
    extent = rng.uniform(0.0, 1.0, (count, 3))
    centre = (1.0 - extent) * rng.uniform(-1.0, 1.0, (count, 3))
    fastest = range.rate * rng.uniform(0.0, 1.0, count)
    turn = _TURN * rng.uniform(0.0, 1.0, count)
    stretch = middle + half * (centre + extent * rng.uniform(-1.0, 1.0, (_KNOTS, count, 3)))
    angle = np.cumsum(turn * rng.uniform(-1.0, 1.0, (_KNOTS, count)), axis=0)
    knots = np.concatenate([stretch, angle[:, :, None]], axis=2)
    walk = PchipInterpolator(np.arange(float(_KNOTS)), knots, axis=0)
    times = np.linspace(0.0, _KNOTS - 1.0, length)
    x, slope = walk(times), walk.derivative()(times)
    U, R = _symmetric(x[..., :3]), _turned(x[..., 3])
    A = slope[..., 3, None, None] * (_turned(np.array(np.pi / 2.0)) @ U) + _symmetric(
        slope[..., :3]
    )
    met = np.abs(A).max(axis=(0, 2, 3), initial=0.0)
    speed = np.divide(fastest, met, out=np.zeros(count), where=met > 0.0)  # knots a µs
    return DeformationPaths("walks", R @ U, R @ (speed[:, None, None] * A), np.arange(count))


def random_loads(load: LoadCase, count: int, seed: int) -> list[LoadCase]:
    """The bar under body forces of any direction that come, go and reverse, of up to 50 µs.

    Their modulus is a quarter to three times that of `load`, uniform; its factor runs linearly
    through values uniform in [−1, 1], the first of them at once.
    """
    rng = np.random.default_rng(seed)
    modulus = float(np.hypot(*load.body_force))
    duration = min(load.duration, _LONGEST_RUN)
    times = np.linspace(0.0, duration, _LOAD_TIMES)
    loads = []
    for _ in np.arange(count):
        angle, factor = rng.uniform(-np.pi, np.pi), rng.uniform(*_LOAD_FACTOR)
        force = modulus * factor * np.array([np.cos(angle), np.sin(angle)])
        amplitude = tuple((t, rng.uniform(-1.0, 1.0)) for t in times.tolist())
        loads.append(
            replace(
                load,
                body_force=tuple(force.tolist()),
                amplitude=amplitude,
                duration=duration,
                output_interval=duration,
            )
        )
    return loads


class WatchedLaw:
    """A stress law that tells the (F, Ḟ) of every time step that a run accepts.

    Attributes:
        note: called with F and F_dot, (n, 2, 2) each, at the end of a step.
    """

    def __init__(self, law: StressLaw, note: Callable[[Array, Array], None]) -> None:
        self.law, self.density, self.has_tangents = law, law.density, law.has_tangents
        self.note = note

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """The law's answer."""
        return self.law.respond(F, F_dot, state, tangents=tangents)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """The law's acceptance, and a note of where it was."""
        self.note(F, F_dot)
        return self.law.accept(F, F_dot, response)


def run_paths(runs: Sequence[Sequence[State]], length: int) -> DeformationPaths:
    """Each run's states, (F, F_dot) of all its points at rising times, as one path.

    `length` states of each run are taken, evenly among its steps; a shorter run repeats some,
    and one without any step is at rest.
    """
    at_rest = [(np.eye(2)[None], np.zeros((1, 2, 2)))]
    histories = []
    for run in runs:
        steps = run or at_rest
        chosen = np.linspace(0, len(steps) - 1, length).round().astype(int)
        histories.append([np.stack([steps[k][part] for k in chosen]) for part in (0, 1)])
    owner = np.repeat(np.arange(len(runs)), [history[0].shape[1] for history in histories])
    if not histories:
        empty = np.empty((length, 0, 2, 2))
        return DeformationPaths("runs", empty, empty, owner)
    F, F_dot = (np.concatenate([h[part] for h in histories], axis=1) for part in (0, 1))
    return DeformationPaths("runs", F, F_dot, owner)


def true_stress(
    paths: DeformationPaths, law: StressLaw, progress: Callable[[int], None] | None = None
) -> tuple[Array, NDArray[np.int8]]:
    """Stress (length n, 2, 2) and status (length n,) of a law along paths, as `states` has them.

    Each history is followed in time from a warm start. Where that ends without a stress, or has
    been beyond a bifurcation, the law is asked once more without one: the status is UNSTABLE
    where both know a stress and the two differ, and where the second leaves a bifurcation too.

    Args:
        progress: called with the number of states done, now and then.
    """
    length, count = paths.F.shape[:2]
    stress = np.empty(paths.F.shape)
    status = np.empty((length, count), dtype=np.int8)
    done = 0
    for first in np.arange(0, count, CHUNK):
        part = slice(first, first + CHUNK)
        state = None
        for k in np.arange(length):
            F, F_dot = (np.ascontiguousarray(T[k, part]) for T in (paths.F, paths.F_dot))
            answer = law.respond(F, F_dot, state)
            acceptance = law.accept(F, F_dot, answer)
            state = acceptance.state
            stress[k, part], status[k, part] = answer.stress, acceptance.status
            doubtful = np.flatnonzero((acceptance.status != 0) | _left(answer) | _left(acceptance))
            if len(doubtful):
                again = law.respond(F[doubtful], F_dot[doubtful])
                points = first + doubtful
                stress[k, points], status[k, points] = _settled(
                    stress[k, points], status[k, points] == 0, again
                )
            done += len(F)
            if progress is not None:
                progress(done)
    return stress.reshape(-1, 2, 2), status.reshape(-1)


def _left(answer: StressResponse | Acceptance) -> NDArray[np.bool_]:
    """(n,) whether points are beyond a bifurcation."""
    left = answer.left_bifurcation
    return np.zeros(len(answer.status), dtype=np.bool_) if left is None else left


def _settled(
    stress: Array, known: NDArray[np.bool_], again: StressResponse
) -> tuple[Array, NDArray[np.int8]]:
    """Stress (n, 2, 2) and status (n,) by a second answer from a cold start.

    Args:
        stress: (n, 2, 2) that histories led to; known: (n,) where there is one.
    """
    status = again.status.copy()
    size = np.sqrt((again.stress**2).sum(axis=(1, 2)))
    with np.errstate(invalid="ignore"):
        other = known & (stress_error(stress, again.stress) > _SAME * (1.0 + size))
    status[(status == 0) & (other | _left(again))] = Status.UNSTABLE
    return again.stress, status


def _box(range: SamplingRange) -> tuple[Array, Array]:
    """Middle and half width (3,) of U₁₁, U₂₂, U₁₂."""
    low, high = range.stretch
    return (
        np.array([0.5 * (low + high), 0.5 * (low + high), 0.0]),
        np.array([0.5 * (high - low), 0.5 * (high - low), range.shear]),
    )


def _symmetric(components: Array) -> Array:
    """(…, 2, 2) tensors of 11, 22 and 12 components (…, 3)."""
    return components[..., [0, 2, 2, 1]].reshape(*components.shape[:-1], 2, 2)


def _turned(angle: Array) -> Array:
    """(…, 2, 2) rotations by an angle (…)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c, -s, s, c], axis=-1).reshape(*np.shape(angle), 2, 2)
