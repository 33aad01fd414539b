"""A problem under other loads: what runs along which a bound is calibrated are loaded by."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surrofe2.problem import Problem
from surrofe2.problem.amplitude import Amplitude, Table, Value
from surrofe2.problem.conditions import BodyForce, Condition, DrivenCondition, InitialVelocity
from surrofe2.problem.rigid_bodies import RigidBody

FACTOR = (0.25, 1.5)
"""Of an amplitude or a velocity, uniform between."""
PACE = (0.5, 2.0)
"""Of all amplitudes, its logarithm uniform between."""


LOAD_FACTOR, LOAD_TIMES, LONGEST_RUN = (0.25, 3.0), 4, 25.0
"""Of a bar: factor of its body force, corners of its amplitude, µs (half a period of the paper's
bar)."""


def random_loads(problem: Problem, count: int, seed: int) -> Iterator[Problem]:
    """The bar under body forces of any direction that come, go and reverse, of up to 25 µs.

    Their modulus is a quarter to three times that of its own, uniform; its factor runs linearly
    through values uniform in [−1, 1], the first of them at once.
    """
    rng = np.random.default_rng(seed)
    *others, load = problem.conditions
    assert isinstance(load, BodyForce)
    modulus = float(np.hypot(*load.acceleration))
    duration = min(problem.duration, LONGEST_RUN)
    times = np.linspace(0.0, duration, LOAD_TIMES)
    for _ in np.arange(count):
        angle, factor = rng.uniform(-np.pi, np.pi), rng.uniform(*LOAD_FACTOR)
        force = modulus * factor * np.array([np.cos(angle), np.sin(angle)])
        course = Table(points=tuple((t, rng.uniform(-1.0, 1.0)) for t in times.tolist()))
        varied = replace(load, acceleration=tuple(force.tolist()), amplitude=course)
        yield replace(
            problem, conditions=(*others, varied), duration=duration, output_interval=duration
        )


@dataclass(frozen=True, slots=True)
class Varied(Amplitude):
    """factor · amplitude(pace · t)."""

    amplitude: Amplitude
    factor: float
    pace: float

    def at(self, t: float, within: float) -> Value:
        factor, pace = self.factor, self.pace
        value, rate, bend = self.amplitude.at(pace * t, pace * within)
        return factor * value, factor * pace * rate, factor * pace**2 * bend

    def corners(self) -> tuple[float, ...]:
        return tuple(t / self.pace for t in self.amplitude.corners())

    @property
    def resolved_by(self) -> float:
        return self.amplitude.resolved_by / self.pace


def varied_problems(problem: Problem, count: int, seed: int) -> Iterator[Problem]:
    """The problem under loads that are weaker or stronger, and faster or slower with its duration.

    Constant loads and initial velocities vary by their factor alone.
    """
    rng = np.random.default_rng(seed)
    for _ in np.arange(count):
        pace = float(np.exp(rng.uniform(*np.log(PACE))))
        conditions = tuple(
            _varied(each, float(rng.uniform(*FACTOR)), pace) for each in problem.conditions
        )
        bodies = tuple(_varied(each, float(rng.uniform(*FACTOR)), pace) for each in problem.bodies)
        yield replace(
            problem,
            conditions=conditions,
            bodies=bodies,
            duration=problem.duration / pace,
            output_interval=problem.duration / pace,
        )


def _varied(stated: Condition | RigidBody, factor: float, pace: float) -> Any:
    if isinstance(stated, DrivenCondition):
        return replace(stated, amplitude=Varied(stated.amplitude, factor, pace))
    if isinstance(stated, InitialVelocity):
        return replace(stated, velocity=_times(factor, stated.velocity))
    if isinstance(stated, RigidBody):
        return replace(
            stated,
            amplitude=Varied(stated.amplitude, factor, pace),
            velocity=_times(factor, stated.velocity),
            acceleration=_times(factor, stated.acceleration),
        )
    return stated


def _times(factor: float, vector: tuple[float, float]) -> tuple[float, float]:
    return factor * vector[0], factor * vector[1]
