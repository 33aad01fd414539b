"""Stress of one point along a path of deformation in time, with components left free of stress.

A uniaxial test prescribes F₁₁ and leaves F₂₂ free; the free entries follow from a first Piola
stress of zero, by BDF 2 in time (backward Euler in the first step) and Newton's method with the
law's own tangents. A law with viscosity creeps in them, as a sample would.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.errors import InputError, SimulationError
from surrofe2.base.tensors import cofactor
from surrofe2.law.stress_law import StressLaw, StressResponse, describe, require_tangents

Entries = tuple[Index, ...]
# A function that returns (F, Ḟ), (2, 2) each, at a time in µs; entries that are free do not count.
Motion = Callable[[float], tuple[Array, Array]]

# Newton's method for the free entries of F: it ends at a step of this size, and fails after so many
# iterations.
_TOLERANCE = 1e-12
_ITERATIONS = 20
# Steps in a period, below which a modulus is not computed.
_LEAST_STEPS = 8


@dataclass(frozen=True, slots=True)
class StressPath:
    """The response of a law along a path.

    Attributes:
        t: (n,) µs, evenly spaced from 0.
        F, F_dot: (n, 2, 2) deformation gradient and its rate, 1/µs.
        stress: (n, 2, 2) Cauchy stress, µN/µm.
        first_piola: (n, 2, 2) P = det F σ F⁻ᵀ, µN/µm.
    """

    t: Array
    F: Array
    F_dot: Array
    stress: Array
    first_piola: Array

    def modulus(self, direction: Array, frequency: float) -> tuple[float, float]:
        """Compute storage and loss modulus, µN/µm, over the last whole period.

        The path must be an `oscillation` in the direction H (2, 2) at this frequency (1/µs). Then
        (P : H)/(H : H) = G′ a sin ωt + G″ a cos ωt to first order in the amplitude a.

        Raises:
            InputError: the path is shorter than a period, or has fewer than 8 steps in one.
        """
        h = self.t[1] - self.t[0]
        steps = round(1.0 / (frequency * h))
        whole = abs(steps * frequency * h - 1.0) < 1e-6  # a whole number of steps is one period
        if len(self.t) <= steps or steps < _LEAST_STEPS or not whole:
            raise InputError(
                f"frequency: {frequency:g} per µs; the path must hold a whole period of at least "
                f"{_LEAST_STEPS} steps, it has steps of {h:g} µs up to {self.t[-1]:g} µs"
            )
        last = slice(len(self.t) - steps, None)
        omega = 2.0 * np.pi * frequency
        size = float(np.sum(direction**2))
        along = np.einsum("nij,ij->n", self.first_piola[last], direction) / size
        strain = np.einsum("nij,ij->n", self.F[last] - np.eye(2), direction) / size
        wave = np.exp(-1j * omega * self.t[last])
        # the Fourier coefficient of the stress over that of the strain is the complex modulus
        # G′ + i G″
        ratio = (along @ wave) / (strain @ wave)
        return float(ratio.real), float(ratio.imag)


def oscillation(direction: Array, amplitude: float, frequency: float) -> Motion:
    """Make the motion F = I + a sin(2π f t) H.

    Args:
        direction: H, (2, 2).
        amplitude: a.
        frequency: f, 1/µs.
    """
    omega = 2.0 * np.pi * frequency

    def motion(t: float) -> tuple[Array, Array]:
        """Return F and Ḟ at t."""
        swing = np.sin(omega * t)
        speed = omega * np.cos(omega * t)
        return np.eye(2) + amplitude * swing * direction, amplitude * speed * direction

    return motion


def ramp_and_hold(target: Array, length: float) -> Motion:
    """Make a motion from I to `target` (2, 2), which is then held.

    The ramp of this length (µs) is s³ (10 − 15 s + 6 s²) with s = t/length; it begins and ends
    without a jump of rate or acceleration.

    Examples:
        >>> import numpy as np
        >>> from surrofe2 import ramp_and_hold
        >>> motion = ramp_and_hold(np.diag([1.02, 1.0]), 100.0)
        >>> for t in (0.0, 50.0, 200.0):
        ...     F, F_dot = motion(t)
        ...     print(f"{t:.0f} µs: {F[0, 0]:.3f}, {1000.0 * F_dot[0, 0]:.3f} per ms")
        0 µs: 1.000, 0.000 per ms
        50 µs: 1.010, 0.375 per ms
        200 µs: 1.020, 0.000 per ms
    """

    def motion(t: float) -> tuple[Array, Array]:
        """Return F and Ḟ at t."""
        s = min(t / length, 1.0)
        rise = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        rate = 30.0 * (s * (1.0 - s)) ** 2 / length
        change = target - np.eye(2)
        return np.eye(2) + rise * change, rate * change

    return motion


def follow_path(
    law: StressLaw,
    motion: Motion,
    duration: float,
    steps: int,
    *,
    free: Sequence[tuple[int, int]] = (),
) -> StressPath:
    """Compute the stress of a law along a motion, from F = I at rest.

    Args:
        law: any stress law; with free entries it must have tangents.
        motion: F and Ḟ in time; see `oscillation` and `ramp_and_hold`.
        duration: length of the path, µs.
        steps: number of even steps.
        free: entries (i, j) of F, from 0, that follow from P_ij = 0; (1, 1) is a uniaxial test
            along x.

    Raises:
        InputError: no step, an entry that F has not, or free entries by a law without tangents.
        SimulationError: the law has no stress, or Newton's method does not converge.

    Examples:
        A uniaxial test of apple flesh: stretched by 1 % along x, free along y. The stress over the
        strain is Young's modulus, the strain across over it Poisson's ratio:

        >>> import numpy as np
        >>> from surrofe2 import RveLaw, follow_path, ramp_and_hold
        >>> law = RveLaw("apple")
        >>> pull = ramp_and_hold(np.diag([1.01, 1.0]), 100.0)
        >>> test = follow_path(law, pull, duration=200.0, steps=20, free=[(1, 1)])
        >>> modulus = test.first_piola[-1, 0, 0] / 0.01 / law.cell.tissue_thickness
        >>> ratio = (1.0 - test.F[-1, 1, 1]) / 0.01
        >>> print(f"{modulus:.2f} MPa, {ratio:.3f}")
        3.74 MPa, 0.015
    """
    if not duration > 0.0 or steps < 1:
        raise InputError(f"duration, steps: {duration}, {steps}; they must be positive")
    if any(not (i in (0, 1) and j in (0, 1)) for i, j in free):
        raise InputError(f"free: {list(free)}; entries of F are (0, 0), (0, 1), (1, 0), (1, 1)")
    if free:
        require_tangents(law, "free")
    h = duration / steps
    state = None
    t: Array = h * np.arange(steps + 1.0)
    entries: Entries = tuple(np.array(free, dtype=np.int64).reshape(-1, 2).T)
    F = np.empty((steps + 1, 2, 2))
    F_dot = np.empty((steps + 1, 2, 2))
    stress = np.empty((steps + 1, 2, 2))
    for n in range(steps + 1):
        F[n], F_dot[n] = motion(float(t[n]))
        # free entries begin Newton's method where they were one step before
        F[n][entries] = F[n - 1][entries] if n else np.eye(2)[entries]
        if n == 0:
            F_dot[0][entries] = 0.0
        if n == 0 or not free:
            answer = _checked(law.respond(F[n : n + 1], F_dot[n : n + 1], state), t[n])
        else:
            # Ḟ = (F − base)/weight, by backward Euler in the first step and BDF 2 later
            base = F[n - 1]
            weight = h
            if n > 1:
                base = (4.0 * F[n - 1] - F[n - 2]) / 3.0
                weight = 2.0 * h / 3.0
            rule = (base[entries], weight)
            answer = _without_stress(law, F[n], F_dot[n], entries, rule, state, t[n])
        accepted = _checked(law.accept(F[n : n + 1], F_dot[n : n + 1], answer), t[n])
        state = accepted.state
        stress[n] = accepted.stress[0]
    return StressPath(t, F, F_dot, stress, np.asarray(stress @ cofactor(F)))


def _checked(response: StressResponse, t: float) -> StressResponse:
    """Return the response, or raise a `SimulationError` with the reason why it has no stress."""
    if response.status.any():
        raise SimulationError(f"t = {t:.6g} µs: {describe(response.status[0])}")
    return response


def _without_stress(
    law: StressLaw,
    F: Array,
    F_dot: Array,
    free: Entries,
    rule: tuple[Array, float],
    state: object,
    t: float,
) -> StressResponse:
    """Change the free entries of F and F_dot, in place, until P is zero there; return the response.

    Args:
        rule: (base, weight), by which the free entries have Ḟ = (F − base)/weight.
        state: the law's committed state.
        t: time, for messages, µs.

    Raises:
        SimulationError: Newton's method does not converge.
    """
    base, weight = rule
    for _ in range(_ITERATIONS):
        F_dot[free] = (F[free] - base) / weight
        answer = _checked(law.respond(F[None], F_dot[None], state, tangents=True), t)
        P = answer.first_piola(F[None])[0]
        assert answer.tangents is not None
        # the rate follows F with 1/weight, as in a step of this length
        slope = answer.tangents.over_step(weight)[0]
        step = np.linalg.solve(slope[free][(slice(None), *free)], P[free])
        if abs(step).max() <= _TOLERANCE:
            return answer
        F[free] -= step
    raise SimulationError(
        f"t = {t:.6g} µs: Newton's method found no deformation free of stress in "
        f"{_ITERATIONS} iterations; take more steps"
    )
