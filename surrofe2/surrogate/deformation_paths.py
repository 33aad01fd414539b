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
from surrofe2.surrogate.products import STRETCH
from surrofe2.surrogate.settings import CORNERS, SMALL

State = tuple[Array, Array]
"""F and F_dot, (n, 2, 2) each."""

# Histories whose stress is computed at once. RVEs keep a warm start of each, so this bounds memory.
CHUNK = 512
# States that a walk passes through between rest and its end.
_KNOTS = 6
# A walk ends in a corner where its coordinates are within this fraction of their half width from
# the ends of the range.
_OUTER = 0.1
# The least factor that draws a whole small walk towards rest, and the least of one coordinate.
_SMALLEST_WALK = 1e-3
_SMALLEST_COORDINATE = 0.1
# The largest turn of R between two knots, in radians.
_TURN = 0.5
# Two stresses within this, relative and in µN/µm, are of one equilibrium.
_SAME = 1e-6


@dataclass(frozen=True, slots=True)
class DeformationPaths:
    """Histories of (F, Ḟ), and which of them belong to one path.

    Attributes:
        kind: name of the kind of paths, e.g. "walks".
        F: (length, n, 2, 2) deformation gradient, in order of time.
        F_dot: (length, n, 2, 2) its rate, 1/µs.
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
        F = np.ascontiguousarray(self.F.reshape(-1, 2, 2))
        F_dot = np.ascontiguousarray(self.F_dot.reshape(-1, 2, 2))
        return F, F_dot

    def largest(self, values: Array) -> Array:
        """Return the largest of `values` (length n,) on each path, (count,)."""
        largest = np.full(self.count, -np.inf)
        largest_of_history = values.reshape(len(self.F), -1).max(axis=0)
        np.maximum.at(largest, self.owner, largest_of_history)
        return largest


@dataclass(frozen=True, slots=True)
class Truth:
    """The response of a full model at the n states of paths, in the order of `paths.states`.

    Attributes:
        stress: (n, 2, 2) Cauchy stress, µN/µm.
        status: (n,) codes of `Status`; where one is not OK the stress does not count.
    """

    paths: DeformationPaths
    stress: Array
    status: NDArray[np.int8]

    @property
    def reached(self) -> Flags:
        """True where every earlier state of the same history has a stress, (n,).

        States behind one without a stress say nothing of the model: a run has ended there, or its
        RVE is in an equilibrium beyond a bifurcation.
        """
        is_lost = self.status.reshape(len(self.paths.F), -1) != 0
        lost_so_far = np.logical_or.accumulate(is_lost, axis=0)
        # the first state without a stress is still reached, so the flags move on by one
        lost_before = np.concatenate([np.zeros_like(is_lost[:1]), lost_so_far[:-1]])
        reached: Flags = ~lost_before
        return reached.ravel()


def random_walks(range: SamplingRange, count: int, length: int, seed: int) -> DeformationPaths:
    """Draw smooth walks of F = R U and RᵀḞ through the range, each from rest to a random end.

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
    at_rest = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # U₁₁, U₂₂, U₁₂ and RᵀḞ
    middle = 0.5 * (lower + upper)
    half_width = 0.5 * (upper - lower)
    rng = np.random.default_rng(seed)
    # The order of the draws below is part of what a seed means: stored calibrations depend on it.
    x = rng.uniform(-1.0, 1.0, (_KNOTS + 1, count, INPUTS))
    side = rng.choice([-1.0, 1.0], (count, INPUTS))
    corner = side * rng.uniform(1 - _OUTER, 1, (count, INPUTS))
    kind = rng.random((count, 1))  # below CORNERS: to a corner; above 1 − SMALL: a small walk
    is_fast = rng.random((count, 1)) < 0.5
    is_stretch = np.arange(INPUTS) < STRETCH
    is_outer = (kind < CORNERS) & (is_fast | is_stretch)
    x[-1] = np.where(is_outer, corner, x[-1])
    factor_of_walk = _SMALLEST_WALK ** rng.random((count, 1))
    factor_of_coordinate = _SMALLEST_COORDINATE ** rng.random((count, INPUTS))
    factor = np.where(kind >= 1.0 - SMALL, factor_of_walk * factor_of_coordinate, 1.0)
    # knot 0 is rest, where all coordinates are zero; the last coordinate is the angle of R
    knots = np.zeros((_KNOTS + 2, count, INPUTS + 1))
    knots[1:, :, :INPUTS] = factor * (middle + half_width * x - at_rest)
    turn = _TURN * rng.random(count) * rng.uniform(-1.0, 1.0, (_KNOTS + 1, count))
    knots[1:, :, INPUTS] = np.cumsum(turn, axis=0)
    walk = PchipInterpolator(np.arange(len(knots)), knots, axis=0)
    states = walk(np.linspace(0.0, len(knots) - 1.0, length))
    # coordinates are in the order U₁₁, U₂₂, U₁₂
    U = np.eye(2) + states[..., [0, 2, 2, 1]].reshape(length, count, 2, 2)
    A = states[..., STRETCH:INPUTS].reshape(length, count, 2, 2)
    cos = np.cos(states[..., INPUTS])
    sin = np.sin(states[..., INPUTS])
    R = np.stack([cos, -sin, sin, cos], axis=-1).reshape(length, count, 2, 2)
    return DeformationPaths("walks", R @ U, R @ A, np.arange(count))


class WatchedLaw:
    """A stress law that calls `note` with F and F_dot (n, 2, 2) at the end of every accepted step.

    It is a `LearningLaw`, so that the end of a step is noted only once all laws of a tissue accept
    it: not where this law objects, nor where another does.
    """

    def __init__(self, law: StressLaw, note: Callable[[Array, Array], None]) -> None:
        self.law = law
        self.density = law.density
        self.has_tangents = law.has_tangents
        self.note = note
        # asked once, since `isinstance` of a protocol takes long
        self._learning = law if isinstance(law, LearningLaw) else None

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """Return the law's response, unchanged."""
        return self.law.respond(F, F_dot, state, tangents=tangents)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Check and commit at once, as a law does that is the only one of a tissue."""
        checked = self.check(F, F_dot, response)
        if checked.status.any():  # the step is rejected, so nothing is noted
            return checked
        return self.commit(F, F_dot, checked)

    def check(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Return the law's response at the end of a step that is not accepted yet."""
        if self._learning is not None:
            return self._learning.check(F, F_dot, response)
        return self.law.accept(F, F_dot, response)

    def commit(self, F: Array, F_dot: Array, checked: StressResponse) -> StressResponse:
        """Note the end of a step, to which nobody objects."""
        self.note(F, F_dot)
        if self._learning is not None:
            return self._learning.commit(F, F_dot, checked)
        return checked


def run_paths(runs: Sequence[Sequence[State]], length: int) -> DeformationPaths:
    """Make one path of each run, from (F, F_dot) of the run's points at rising times.

    `length` states of each run are taken, evenly among its steps; a shorter run repeats some,
    and one without any step is at rest.
    """
    at_rest = [(np.eye(2)[None], np.zeros((1, 2, 2)))]
    deformations = []
    rates = []
    points_per_run = []
    for run in runs:
        steps = run or at_rest
        chosen = np.linspace(0, len(steps) - 1, length).round().astype(int)
        states = [steps[k] for k in chosen]
        F = np.stack([F for F, _ in states])
        F_dot = np.stack([F_dot for _, F_dot in states])
        deformations.append(F)
        rates.append(F_dot)
        points_per_run.append(F.shape[1])
    return DeformationPaths(
        kind="runs",
        F=np.concatenate(deformations, axis=1),
        F_dot=np.concatenate(rates, axis=1),
        owner=np.repeat(np.arange(len(runs)), points_per_run),
    )


def true_stress(
    paths: DeformationPaths, law: StressLaw, progress: Callable[[int], None] | None = None
) -> Truth:
    """Compute the stress and status of a law along paths.

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
            F = np.ascontiguousarray(paths.F[k, part])
            F_dot = np.ascontiguousarray(paths.F_dot[k, part])
            answer = law.respond(F, F_dot, state)
            accepted = law.accept(F, F_dot, answer)
            state = accepted.state
            stress[k, part] = answer.stress
            status[k, part] = accepted.status
            is_doubtful = (
                (accepted.status != 0)
                | _is_beyond_bifurcation(answer)
                | _is_beyond_bifurcation(accepted)
            )
            doubtful = np.flatnonzero(is_doubtful)
            if len(doubtful):
                points = first + doubtful
                cold = law.respond(F[doubtful], F_dot[doubtful])
                has_both = (cold.status == 0) & (status[k, points] == 0)
                size = np.sqrt((cold.stress**2).sum(axis=(1, 2)))
                # a stress is NaN where there is none; `has_both` leaves these points out
                with np.errstate(invalid="ignore"):
                    differs = stress_error(stress[k, points], cold.stress) > _SAME * (1.0 + size)
                stays_beyond = (cold.status == 0) & _is_beyond_bifurcation(cold)
                is_unstable = (has_both & differs) | stays_beyond
                stress[k, points] = cold.stress
                status[k, points] = np.where(is_unstable, Status.UNSTABLE, cold.status)
            done += len(F)
            if progress is not None:
                progress(done)
    return Truth(paths, stress.reshape(-1, 2, 2), status.reshape(-1))


def _is_beyond_bifurcation(response: StressResponse) -> Flags:
    """Return (n,) whether points are beyond a bifurcation; False where the law does not tell."""
    if response.left_bifurcation is None:
        return np.zeros(len(response.status), dtype=np.bool_)
    return response.left_bifurcation
