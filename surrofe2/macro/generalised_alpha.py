"""Generalised-α: one implicit step by full Newton, as formulas.

Chung and Hulbert, A time integration algorithm for structural dynamics with improved numerical
dissipation, J. Appl. Mech. 60 (1993) 371–375, the forces averaged between the ends of the step:

    (1 − α_m) M a₁ + α_m M a₀ + (1 − α_f) (f₁ − l₁) + α_f (f₀ − l₀) = 0
    u₁ = u₀ + h v₀ + h² [(½ − β) a₀ + β a₁],   v₁ = v₀ + h [(1 − γ) a₀ + γ a₁]

with f the internal force and l the load. The algorithmic acceleration a is not ü, which would be
M⁻¹(l − f); it lags by (α_m − α_f) h, to second order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from surrofe2.macro.right_hand_side import Evaluation, RightHandSide
from surrofe2.macro.tangent_assembly import (
    assembled_tangents,
    factorised,
    make_pattern,
    mass_matrix,
)

Array = NDArray[np.float64]

MAX_ITERATIONS = 12


@dataclass(frozen=True, slots=True)
class Weights:
    """α_m, α_f, β, γ; second order and unconditionally stable for linear problems."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float

    @classmethod
    def of(cls, spectral_radius: float) -> Weights:
        """The weights whose amplification at infinite frequency is `spectral_radius`."""
        rho = spectral_radius
        alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
        shift = alpha_f - alpha_m
        return cls(alpha_m, alpha_f, 0.25 * (1.0 + shift) ** 2, 0.5 + shift)


@dataclass(frozen=True, slots=True)
class Solved:
    """End of a step: its evaluation, algorithmic acceleration and how Newton came there.

    Attributes:
        now: the evaluation at the end of the step.
        a: (n_free, 2) algorithmic acceleration there.
        residuals: residual relative to the largest of the forces, before each correction and
            at the end.
        solve: the factorised Newton matrix S of the last correction, S⁻¹ applied to (2 n_free,).
    """

    now: Evaluation
    a: Array
    residuals: tuple[float, ...]
    solve: Callable[[Array], Array]


class GeneralisedAlpha:
    """Solves single steps for one bar and law; keeps nothing but the matrices' pattern."""

    def __init__(
        self, right_hand_side: RightHandSide, spectral_radius: float, tolerance: float
    ) -> None:
        self.weights = Weights.of(spectral_radius)
        self.mass = mass_matrix(right_hand_side.bar)
        self._tolerance = tolerance
        self._right_hand_side = right_hand_side
        self._pattern = make_pattern(right_hand_side.bar)

    def acceleration(self, now: Evaluation) -> Array:
        """(n_free, 2) ü = M⁻¹ (l − f)."""
        return self._right_hand_side.bar.solve_mass(now.load - now.internal)

    def acceleration_to(self, u: Array, start: Evaluation, a: Array, h: float) -> Array:
        """(n_free, 2) algorithmic acceleration at the end of a step that leads to u."""
        w = self.weights
        known = start.u + h * start.v + h**2 * (0.5 - w.beta) * a
        return np.asarray((u - known) / (h**2 * w.beta))

    def solve(self, start: Evaluation, a: Array, guess: Array, h: float) -> Solved:
        """The step of length h from `start` with algorithmic acceleration a.

        Args:
            guess: (n_free, 2) acceleration at the end that Newton begins with.

        Raises:
            TrialError: no stress on the way, or no convergence.
        """
        w, rhs = self.weights, self._right_hand_side
        t = start.t + h
        u_known = start.u + h * start.v + h**2 * (0.5 - w.beta) * a
        v_known = start.v + h * (1.0 - w.gamma) * a
        before = w.alpha_m * (self.mass @ a.ravel()).reshape(a.shape)
        before += w.alpha_f * (start.internal - start.load)
        a_end, residuals, solve = guess, [], None
        while True:
            now = rhs.evaluate(
                t, u_known + h**2 * w.beta * a_end, v_known + h * w.gamma * a_end, tangents=True
            )
            inertia = (1.0 - w.alpha_m) * (self.mass @ a_end.ravel()).reshape(a.shape)
            residual = before + inertia + (1.0 - w.alpha_f) * (now.internal - now.load)
            scale = max(abs(force).max() for force in (now.internal, now.load, inertia, before))
            residuals.append(abs(residual).max() / max(scale, np.finfo(float).tiny))
            converged = residuals[-1] <= self._tolerance
            if solve is None or not converged:
                if len(residuals) > MAX_ITERATIONS:
                    self._give_up(now, residual, f"no convergence in {MAX_ITERATIONS} iterations")
                solve = factorised(self._matrix(now, h))
                if solve is None:
                    self._give_up(now, residual, "the matrix is singular")
                rhs.tally.counts["factorisations"] += 1
            if converged:
                return Solved(now, a_end, tuple(residuals), solve)
            a_end = a_end - solve(residual.ravel()).reshape(a.shape)

    def _matrix(self, now: Evaluation, h: float) -> csc_matrix:
        """S = (1 − α_m) M + (1 − α_f) (h γ C + h² β K), the derivative of the residual by a₁."""
        w, bar = self.weights, self._right_hand_side.bar
        K, C = assembled_tangents(bar, self._pattern, now.F, now.response)
        return csc_matrix(
            (1.0 - w.alpha_m) * self.mass
            + (1.0 - w.alpha_f) * (h * w.gamma * C + h**2 * w.beta * K)
        )

    def _give_up(self, now: Evaluation, residual: Array, reason: str) -> NoReturn:
        """Say why, at a point near the node that is least in balance."""
        point = self._right_hand_side.bar.point_near(int(abs(residual).max(axis=1).argmax()))
        self._right_hand_side.fail(now.t, point, now.F, f"Newton near this point: {reason}")
