"""Damped modes in a displacement curve: period and logarithmic decrement.

See docs/theory.md, period and decrement.
Least squares of a constant and two exponentially damped cosines::

    u(t) ≈ c + Σₖ e^(−δₖ t) (aₖ cos ωₖ t + bₖ sin ωₖ t),    k = 1, 2

Minima read off a curve are biased by its second mode; the fit is not. c, aₖ, bₖ are linear and
eliminated (variable projection), so that only ωₖ and δₖ are searched for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from surrofe2.base.errors import InputError

Array = NDArray[np.float64]

_CANDIDATES = 4
_HIGHEST = 60.0
"""Fastest mode looked for, cycles in the whole curve."""


@dataclass(frozen=True, slots=True)
class Mode:
    """period: 2π/ω, µs. decrement: δ 2π/ω, logarithmic, a period. amplitude: at t = 0, µm."""

    period: float
    decrement: float
    amplitude: float


@dataclass(frozen=True, slots=True)
class DampedFit:
    """constant: the state of rest, µm. first: the mode of largest amplitude. residual: largest
    difference between fit and curve, rms: its root mean square, µm."""

    constant: float
    first: Mode
    second: Mode
    residual: float
    rms: float


def fit_damped_modes(t: Array, u: Array) -> DampedFit:
    """Fit a constant and two damped modes to u(t); t in µs, evenly spaced, u in µm.

    Raises:
        InputError: fewer than 20 samples or a curve that does not move.
    """
    t, u = np.asarray(t, np.float64) - t[0], np.asarray(u, np.float64)
    if t.ndim != 1 or t.shape != u.shape or len(t) < 20:
        raise InputError(f"damped fit: t {t.shape} and u {u.shape}; both must be (m,), m ≥ 20")
    if not np.isfinite(u).all() or np.ptp(u) == 0.0:
        raise InputError("damped fit: the curve must be finite and move")
    modes = np.empty((0, 2))
    for _ in range(2):
        trials = [_refined(t, u, np.vstack([modes, (w, 0.0)])) for w in _omegas(t, u, modes)]
        modes = min(trials, key=lambda trial: _cost(t, u, trial))
    return _summary(t, u, modes)


def first_minimum(t: Array, u: Array) -> tuple[float, float]:
    """(t, u) of the first interior minimum, by the parabola through its three lowest samples.

    Args:
        t: (m,) increasing, µs.
        u: (m,) at these times, µm.

    Raises:
        InputError: there is no minimum within.
    """
    lower = np.flatnonzero((u[1:-1] < u[:-2]) & (u[1:-1] <= u[2:]))
    if lower.size == 0:
        raise InputError("first minimum: the curve has none; let the run last longer")
    k = int(lower[0]) + 1
    a, b, c = np.polyfit(t[k - 1 : k + 2] - t[k], u[k - 1 : k + 2], 2)
    return float(t[k] - b / (2.0 * a)), float(c - b * b / (4.0 * a))


# Modes are (k, 2): ω and δ of each, 1/µs.


def _projected(t: Array, u: Array, modes: Array) -> tuple[Array, Array]:
    """Best coefficients c, a₁, b₁, a₂, … of the modes, and what they leave of u."""
    columns = [np.ones_like(t)]
    for omega, delta in modes:
        decay = np.exp(-delta * t)
        columns += [decay * np.cos(omega * t), decay * np.sin(omega * t)]
    basis = np.stack(columns, axis=1)
    coefficients = np.asarray(np.linalg.lstsq(basis, u, rcond=None)[0])
    return coefficients, u - basis @ coefficients


def _cost(t: Array, u: Array, modes: Array) -> float:
    return float(np.sum(_projected(t, u, modes)[1] ** 2))


def _omegas(t: Array, u: Array, known: Array) -> Array:
    """ω of the best undamped modes to add to the known ones, a local best each."""
    cycles = np.arange(0.5, min(_HIGHEST, 0.4 * len(t)), 0.25)
    omegas = 2.0 * np.pi * cycles / t[-1]
    costs = np.array([_cost(t, u, np.vstack([known, (w, 0.0)])) for w in omegas])
    padded = np.concatenate([[np.inf], costs, [np.inf]])
    local = np.flatnonzero((costs <= padded[:-2]) & (costs <= padded[2:]))
    return omegas[local[np.argsort(costs[local])][:_CANDIDATES]]


def _refined(t: Array, u: Array, modes: Array) -> Array:
    """Least squares from a guess; frequencies stay positive, growth is bounded."""
    scale = 2.0 * np.pi / t[-1]
    low = np.tile([0.1, -1.0], len(modes))
    high = np.tile([1.2 * _HIGHEST, 20.0], len(modes))
    solved = least_squares(
        lambda p: _projected(t, u, p.reshape(-1, 2) * scale)[1],
        np.clip(modes.ravel() / scale, low + 1e-6, high - 1e-6),
        jac="3-point",
        bounds=(low, high),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
        max_nfev=60,
    )
    return np.asarray(solved.x.reshape(-1, 2) * scale)


def _summary(t: Array, u: Array, modes: Array) -> DampedFit:
    coefficients, left = _projected(t, u, modes)
    amplitudes = np.hypot(coefficients[1::2], coefficients[2::2])
    first, second = np.argsort(-amplitudes, kind="stable")[:2]

    def mode(k: int) -> Mode:
        omega, delta = modes[k]
        period = 2.0 * np.pi / omega
        return Mode(float(period), float(delta * period), float(amplitudes[k]))

    return DampedFit(
        constant=float(coefficients[0]),
        first=mode(first),
        second=mode(second),
        residual=float(np.abs(left).max()),
        rms=float(np.sqrt(np.mean(left**2))),
    )
