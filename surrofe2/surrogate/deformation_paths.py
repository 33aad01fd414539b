"""Paths of deformation in (F, Ḟ), along which a bound is calibrated, and the RVE's stress there.

Neighbouring states share their error, so a whole path counts once. There are random walks through
a sampling range, and short runs of a problem, of which a few points together are one path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.sampling import SamplingRange
from surrofe2.base.tensors import INPUTS, stress_error
from surrofe2.law.stress_law import LearningLaw, Status, StressLaw, StressResponse
from surrofe2.surrogate.settings import CORNERS, SMALL

State = tuple[Array, Array]

CHUNK = 512  # histories asked at once: RVEs keep a warm start of each
_KNOTS = 6  # states that a walk passes through between rest and its end
_OUTER = 0.1  # of the half width: a corner
_SMALLEST = 1e-3  # of a walk, among the small ones
_LEAST = 0.1  # of a component of these
_TURN = 0.5  # radians between two knots, at most
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
    owner: Index

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


@dataclass(frozen=True, slots=True)
class Truth:
    """Stress (n, 2, 2) and status (n,) by a full model at the states of paths."""

    paths: DeformationPaths
    stress: Array
    status: NDArray[np.int8]

    @property
    def reached(self) -> Flags:
        """(n,) whether no earlier state of the same history is without a stress; what follows
        says nothing: a run has ended there, or its RVE answers from beyond a bifurcation."""
        lost = self.status.reshape(len(self.paths.F), -1) != 0
        before = np.logical_or.accumulate(lost, axis=0)
        reached: Flags = ~np.concatenate([np.zeros_like(lost[:1]), before[:-1]])
        return reached.ravel()


def random_walks(range: SamplingRange, count: int, length: int, seed: int) -> DeformationPaths:
    """Smooth walks of F = R U and RᵀḞ through the range, each from rest to a random end.

    U₁₁, U₂₂, U₁₂ and the entries of RᵀḞ, seven coordinates, begin at (I, 0) and run through random
    knots to their end by monotone cubics, which stay between their knots; so does the angle of R.
    `length` states are taken at even times, the first of them at rest.

    All walks are draws of one distribution. Knots and end are uniform over the range, except that

    - with probability `CORNERS` the walk ends where U₁₁, U₂₂ and U₁₂ are all within the outer
      tenth of their half width, in half of these walks the entries of RᵀḞ too;
    - with probability `SMALL` the whole walk is drawn towards rest by a factor whose logarithm is
      uniform down to that of 0.001, and each coordinate by another, down to 0.1. So no size of
      load is left out, nor a shear wave, which begins with its rate alone.
    """
    # The stress depends on (F, Ḟ) alone: with a rate of its own a walk reaches all of the range,
    # where a rate of dF/dt would rarely be large in all entries at once.
    lower, upper = range.ends
    at_rest = np.array([1.0, 1.0, *[0.0] * (INPUTS - 2)])
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (_KNOTS + 1, count, INPUTS))
    corner = rng.choice([-1.0, 1.0], (count, INPUTS)) * rng.uniform(1 - _OUTER, 1, (count, INPUTS))
    part, is_fast = rng.random((count, 1)), rng.random((count, 1)) < 0.5
    is_outer = (part < CORNERS) & (is_fast | (np.arange(INPUTS) < 3))
    x[-1] = np.where(is_outer, corner, x[-1])
    whole, each = _SMALLEST ** rng.random((count, 1)), _LEAST ** rng.random((count, INPUTS))
    factor = np.where(part >= 1.0 - SMALL, whole * each, 1.0)
    knots = np.zeros((_KNOTS + 2, count, INPUTS + 1))
    knots[1:, :, :INPUTS] = factor * (0.5 * (lower + upper) + 0.5 * (upper - lower) * x - at_rest)
    turn = _TURN * rng.random(count) * rng.uniform(-1.0, 1.0, (_KNOTS + 1, count))
    knots[1:, :, INPUTS] = np.cumsum(turn, axis=0)
    walk = PchipInterpolator(np.arange(len(knots)), knots, axis=0)
    states = walk(np.linspace(0.0, len(knots) - 1.0, length))
    U = np.eye(2) + states[..., [0, 2, 2, 1]].reshape(length, count, 2, 2)
    A = states[..., 3:INPUTS].reshape(length, count, 2, 2)
    c, s = np.cos(states[..., INPUTS]), np.sin(states[..., INPUTS])
    R = np.stack([c, -s, s, c], axis=-1).reshape(length, count, 2, 2)
    return DeformationPaths("walks", R @ U, R @ A, np.arange(count))


class WatchedLaw:
    """A stress law that calls `note` with F and F_dot (n, 2, 2) at the end of every accepted step.

    An end to which the law objects is not noted, nor one to which another law of the same tissue
    does: it is a `LearningLaw`.
    """

    def __init__(self, law: StressLaw, note: Callable[[Array, Array], None]) -> None:
        self.law, self.density, self.has_tangents = law, law.density, law.has_tangents
        self.note = note

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        return self.law.respond(F, F_dot, state, tangents=tangents)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        checked = self.check(F, F_dot, response)
        return checked if checked.status.any() else self.commit(F, F_dot, checked)

    def check(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """What the law makes of the end of a step, which is not accepted yet."""
        if isinstance(self.law, LearningLaw):
            return self.law.check(F, F_dot, response)
        return self.law.accept(F, F_dot, response)

    def commit(self, F: Array, F_dot: Array, checked: StressResponse) -> StressResponse:
        """Note the end of a step, to which nobody objects."""
        self.note(F, F_dot)
        if isinstance(self.law, LearningLaw):
            return self.law.commit(F, F_dot, checked)
        return checked


def run_paths(runs: Sequence[Sequence[State]], length: int) -> DeformationPaths:
    """Each run's states, (F, F_dot) of its points at rising times, as one path.

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
    F, F_dot = (np.concatenate([h[part] for h in histories], axis=1) for part in (0, 1))
    return DeformationPaths("runs", F, F_dot, owner)


def true_stress(
    paths: DeformationPaths, law: StressLaw, progress: Callable[[int], None] | None = None
) -> Truth:
    """Stress and status of a law along paths.

    Each history is followed in time with a warm start. Where that ends without a stress, or has
    been beyond a bifurcation, the stress is computed again without one: the status is UNSTABLE
    where both have a stress and the two differ, and where the second leaves a bifurcation too.

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
            accepted = law.accept(F, F_dot, answer)
            state = accepted.state
            stress[k, part], status[k, part] = answer.stress, accepted.status
            doubtful = np.flatnonzero((accepted.status != 0) | _left(answer) | _left(accepted))
            if len(doubtful):
                again, points = law.respond(F[doubtful], F_dot[doubtful]), first + doubtful
                known = (again.status == 0) & (status[k, points] == 0)
                size = np.sqrt((again.stress**2).sum(axis=(1, 2)))
                with np.errstate(invalid="ignore"):
                    differs = stress_error(stress[k, points], again.stress) > _SAME * (1.0 + size)
                unstable = (known & differs) | ((again.status == 0) & _left(again))
                stress[k, points] = again.stress
                status[k, points] = np.where(unstable, Status.UNSTABLE, again.status)
            done += len(F)
            if progress is not None:
                progress(done)
    return Truth(paths, stress.reshape(-1, 2, 2), status.reshape(-1))


def _left(answer: StressResponse) -> Flags:
    """(n,) whether points are beyond a bifurcation."""
    left = answer.left_bifurcation
    return np.zeros(len(answer.status), dtype=np.bool_) if left is None else left
