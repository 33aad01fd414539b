"""Implicit steps of generalised-α, their length chosen by the error of each.

A step of h leaves the error of [u, v] that a third-order method finds: the integral of the
parabola through the rates [v, ü] at the last three ends of steps (Adams–Moulton), minus the step.
Stiff modes would drown it, so it passes through S⁻¹ (1 − α_m) M, S the Newton matrix, which
leaves slow modes as they are and damps fast ones.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import SimulationError
from surrofe2.macro.generalised_alpha import GeneralisedAlpha, Solved
from surrofe2.macro.right_hand_side import Evaluation, RightHandSide, SwitchedError, TrialError
from surrofe2.macro.settings import MacroSettings
from surrofe2.macro.time_integration import MAX_HALVINGS, NO_MEMORY
from surrofe2.stress_law import require_tangents

Array = NDArray[np.float64]

_SAFETY, _SHRINK, _GROW = 0.9, 0.2, 2.0
_SMALLEST = 1e-10
"""Smallest step relative to the duration."""


@dataclass(frozen=True, slots=True)
class ImplicitStep:
    """An accepted step from t_old to t; attributes as of `time_integration.Step`.

    Attributes:
        rates: (2, 4 n_free) [v, ü] at both ends.
        y_old: (4 n_free,) state at t_old.
        end_powers: (2, 2) internal and load power at both ends.
        memory: see `ImplicitStepper.memory`.
        residuals: of Newton, see `generalised_alpha.Solved`.
    """

    t_old: float
    t: float
    y: Array
    next_step: float
    evaluation: Evaluation
    y_old: Array
    rates: Array
    end_powers: Array
    residuals: tuple[float, ...]
    memory: Array

    def interpolate(self, t: float) -> Array:
        """(4 n_free,) y within the step: the cubic with the values and rates of both ends."""
        h = self.t - self.t_old
        s = (t - self.t_old) / h
        blend = s * s * (3.0 - 2.0 * s)
        values = self.y_old + blend * (self.y - self.y_old)
        out: Array = values + h * s * (1.0 - s) * ((1.0 - s) * self.rates[0] - s * self.rates[1])
        return out

    def work(self, t: float) -> Array:
        """(2,) internal and load work from t_old to t, pJ: powers linear in time, second order."""
        h = self.t - self.t_old
        s = (t - self.t_old) / h
        work: Array = h * s * ((1.0 - 0.5 * s) * self.end_powers[0] + 0.5 * s * self.end_powers[1])
        return work


@dataclass(frozen=True, slots=True)
class _Standing:
    """Where the stepper stands: replaced as a whole by an accepted step.

    Attributes:
        now: the evaluation there.
        a: (n_free, 2) algorithmic acceleration.
        h: length of the step that led there, µs.
        rate: (4 n_free,) [v, ü]; rate_old: that a step before, None at the start.
    """

    now: Evaluation
    a: Array
    h: float
    rate: Array
    rate_old: Array | None = None

    @property
    def memory(self) -> Array:
        """What cannot be computed from `now`, as one array."""
        old = NO_MEMORY if self.rate_old is None else self.rate_old
        return np.concatenate([[self.h], self.a.ravel(), old])

    def remembering(self, memory: Array) -> _Standing:
        """The same place with the past that `memory` was taken of."""
        size = self.a.size
        old = memory[1 + size :]
        return replace(
            self,
            h=float(memory[0]),
            a=memory[1 : 1 + size].reshape(self.a.shape),
            rate_old=old if old.size else None,
        )

    def on_another_branch(self, now: Evaluation, rate: Array) -> _Standing:
        """The same place where the law answers otherwise: what was known moves by the jump, so
        that neither the error nor the first guess of the next step takes it for a motion."""
        jump = rate - self.rate
        a = self.a + jump.reshape(2, -1, 2)[1]
        rate_old = None if self.rate_old is None else self.rate_old + jump
        return _Standing(now, a, self.h, rate, rate_old)


class ImplicitStepper:
    """Accepted steps, one after another, from (t, y) to t_end; takes the place of `Stepper`."""

    def __init__(
        self,
        right_hand_side: RightHandSide,
        t: float,
        y: Array,
        t_end: float,
        settings: MacroSettings,
        first_step: float | None = None,
        memory: Array | None = None,
    ) -> None:
        require_tangents(right_hand_side.law, "integrator implicit")
        self._right_hand_side = right_hand_side
        self._settings = settings
        self._t_end = t_end
        self._method = GeneralisedAlpha(
            right_hand_side, settings.spectral_radius, settings.newton_tolerance
        )
        u, v = y.reshape(2, -1, 2)
        self.start = right_hand_side.evaluate(t, u, v)
        start = right_hand_side.accept()
        a = self._method.acceleration(start)
        self._standing = _Standing(start, a, 1.0, _rate(start, a))
        if memory is not None:
            self._standing = self._standing.remembering(memory)
        self._h = first_step or self._first_step(a)

    @property
    def next_step(self) -> float:
        """Length proposed for the next step, µs."""
        return self._h

    @property
    def memory(self) -> Array:
        """(1 + 2 n_free,) or, after the first step, (1 + 6 n_free,): length of the last step in
        µs, algorithmic acceleration, [v, ü] a step before. With y all that the method needs."""
        return self._standing.memory

    def advance(self) -> ImplicitStep:
        """The next accepted step; failed trials halve it, ten times at most.

        A trial in which points left their branch of the law is repeated at its length.
        """
        counts = self._right_hand_side.tally.counts
        halvings, grow = 0, _GROW
        while True:
            now = self._standing.now
            h, last = self._length()
            if h < _SMALLEST * self._t_end:
                raise SimulationError(
                    f"time integration stopped at t = {now.t:.6g} µs: the error asks for steps "
                    "below rounding; loosen the tolerances"
                )
            try:
                solved = self._try_on_one_branch(h)
                error = self._error(solved, h)
                start = self._right_hand_side.accept() if error <= 1.0 else solved.now
            except TrialError:
                counts["failed_trials"] += 1
                if halvings == MAX_HALVINGS:
                    raise
                halvings, grow, self._h = halvings + 1, 1.0, 0.5 * h
                continue
            factor = _SAFETY * max(error, 1e-9) ** (-1.0 / 3.0)
            if error > 1.0:
                counts["rejected_steps"] += 1
                grow, self._h = 1.0, h * max(_SHRINK, factor)
                continue
            counts["steps"] += 1
            wanted = h * min(grow, max(_SHRINK, factor))
            # A step cut short to meet the end says nothing against the longer one.
            self._h = min(self._settings.largest_step, max(wanted, self._h if last else 0.0))
            return self._commit(solved, start, h, last)

    def _length(self) -> tuple[float, bool]:
        """Length to try, and whether it is cut to end at t_end."""
        left = self._t_end - self._standing.now.t
        h = min(self._h, self._settings.largest_step)
        if h * (1.0 + 1e-9) >= left:
            return left, True
        return (0.5 * left, False) if 2.0 * h > left else (h, False)

    def _try_on_one_branch(self, h: float) -> Solved:
        """A step of h, begun anew as long as points leave their branch of the law.

        Newton goes on from where it found them.
        """
        guess = None
        while True:
            at, a = self._standing, self._acceleration(h)
            if guess is None:
                guess = self._guess(a, h)
            try:
                return self._method.solve(at.now, a, guess, h)
            except SwitchedError as found:
                now = self._right_hand_side.restart_step(found.switched)
                rate = _rate(now, self._method.acceleration(now))
                self._standing = at.on_another_branch(now, rate)
                guess = self._method.acceleration_to(found.u, now, self._acceleration(h), h)

    def _acceleration(self, h: float) -> Array:
        """The algorithmic acceleration, its lag brought from the last step's to this one's."""
        at = self._standing
        acceleration = at.rate.reshape(2, -1, 2)[1]
        a: Array = acceleration + h / at.h * (at.a - acceleration)
        return a

    def _guess(self, a: Array, h: float) -> Array:
        """The same at the end of the step, carried on straight."""
        at = self._standing
        if at.rate_old is None:
            return a
        change = at.rate.reshape(2, -1, 2)[1] - at.rate_old.reshape(2, -1, 2)[1]
        return np.asarray(a + h / at.h * change)

    def _error(self, solved: Solved, h: float) -> float:
        """Root mean square of the error of y relative to what is allowed."""
        at, method = self._standing, self._method
        rate = _rate(solved.now, method.acceleration(solved.now))
        y_old, y = _state(at.now), _state(solved.now)
        error = y - y_old - h * _parabola_mean(at.rate_old, at.rate, rate, at.h, h)
        scale = self._settings.absolute_tolerance + self._settings.relative_tolerance * np.maximum(
            abs(y), abs(y_old)
        )
        filtered = [
            (1.0 - method.weights.alpha_m) * solved.solve(method.mass @ part)
            for part in error.reshape(2, -1)
        ]
        return float(np.sqrt(np.mean((np.concatenate(filtered) / scale) ** 2)))

    def _commit(self, solved: Solved, start: Evaluation, h: float, last: bool) -> ImplicitStep:
        """Stand at `start`, the end of the step as the law answers there from now on."""
        at, now = self._standing, solved.now
        rate = _rate(now, self._method.acceleration(now))
        self._standing = _Standing(now, solved.a, h, rate, at.rate)
        if start is not now:
            begin = _rate(start, self._method.acceleration(start))
            self._standing = self._standing.on_another_branch(start, begin)
        return ImplicitStep(
            t_old=at.now.t,
            t=self._t_end if last else now.t,
            y=_state(now),
            next_step=self._h,
            evaluation=now,
            y_old=_state(at.now),
            rates=np.stack([at.rate, rate]),
            end_powers=np.stack([at.now.powers, now.powers]),
            residuals=solved.residuals,
            memory=self.memory,
        )

    def _first_step(self, a: Array) -> float:
        """So short that the displacement gained is what the tolerance allows."""
        limit = min(self._settings.largest_step, 1e-2 * self._t_end)
        strongest = float(abs(a).max())
        if strongest == 0.0:
            return limit
        return min(limit, float(np.sqrt(10.0 * self._settings.absolute_tolerance / strongest)))


def _state(now: Evaluation) -> Array:
    return np.concatenate([now.u.ravel(), now.v.ravel()])


def _rate(now: Evaluation, acceleration: Array) -> Array:
    return np.concatenate([now.v.ravel(), acceleration.ravel()])


def _parabola_mean(before: Array | None, start: Array, end: Array, h_old: float, h: float) -> Array:
    """Mean rate over a step of h: (start + end)/2 − h²/6 [before, start, end].

    [·] is the second divided difference of the rates h_old before the step and at its ends; where
    there is none before, the straight line has to do.
    """
    line = 0.5 * (start + end)
    if before is None:
        return line
    curvature = ((end - start) / h - (start - before) / h_old) / (h + h_old)
    mean: Array = line - h**2 / 6.0 * curvature
    return mean
