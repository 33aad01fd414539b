"""Damped modes in a displacement curve: period and logarithmic decrement.

See docs/theory.md, period and decrement.
Least squares of a constant and exponentially damped cosines, two unless told otherwise::

    u(t) ≈ c + Σₖ e^(−δₖ t) (aₖ cos ωₖ t + bₖ sin ωₖ t),    k = 1, 2

Minima read off a curve are biased by its second mode; the fit is not. c, aₖ, bₖ are linear and
eliminated (variable projection), so that only ωₖ and δₖ are searched for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from surrofe2.errors import InputError

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
    difference between fit and curve, rms: its root mean square, µm. decrement_error: standard
    error of the first mode's decrement from the residuals' covariance."""

    constant: float
    first: Mode
    second: Mode
    residual: float
    rms: float
    decrement_error: float


def fit_damped_modes(t: Array, u: Array, count: int = 2) -> DampedFit:
    """Fit a constant and `count` damped modes to u(t); t in µs, evenly spaced, u in µm.

    Raises:
        InputError: fewer than 20 samples, a curve that does not move, or a count below 2.
    """
    if count < 2:
        raise InputError(f"damped fit: {count} modes; it must be at least 2")
    t, u = np.asarray(t, np.float64) - t[0], np.asarray(u, np.float64)
    if t.ndim != 1 or t.shape != u.shape or len(t) < 20:
        raise InputError(f"damped fit: t {t.shape} and u {u.shape}; both must be (m,), m ≥ 20")
    if not np.isfinite(u).all() or np.ptp(u) == 0.0:
        raise InputError("damped fit: the curve must be finite and move")
    modes: Modes = []
    for _ in range(count):
        trials = [_refined(t, u, [*modes, (w, 0.0)]) for w in _frequencies(t, u, modes)]
        modes = min(trials, key=_cost(t, u))
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


Modes = list[tuple[float, float]]
"""(ω, δ) of each mode, 1/µs."""


def _basis(t: Array, modes: Modes) -> Array:
    columns = [np.ones_like(t)]
    for omega, delta in modes:
        decay = np.exp(-delta * t)
        columns += [decay * np.cos(omega * t), decay * np.sin(omega * t)]
    return np.stack(columns, axis=1)


def _coefficients(t: Array, u: Array, modes: Modes) -> Array:
    return np.asarray(np.linalg.lstsq(_basis(t, modes), u, rcond=None)[0])


def _residual(t: Array, u: Array, modes: Modes) -> Array:
    return np.asarray(u - _basis(t, modes) @ _coefficients(t, u, modes))


def _cost(t: Array, u: Array):  # type: ignore[no-untyped-def]
    return lambda modes: float(np.sum(_residual(t, u, modes) ** 2))


def _frequencies(t: Array, u: Array, known: Modes) -> list[float]:
    """ω of the best undamped modes to add to the known ones, a local best each."""
    cycles = np.arange(0.5, min(_HIGHEST, 0.4 * len(t)), 0.25)
    omegas = 2.0 * np.pi * cycles / t[-1]
    cost = _cost(t, u)
    costs = np.array([cost([*known, (w, 0.0)]) for w in omegas])
    padded = np.concatenate([[np.inf], costs, [np.inf]])
    local = np.flatnonzero((costs <= padded[:-2]) & (costs <= padded[2:]))
    best = local[np.argsort(costs[local])][:_CANDIDATES]
    return [float(omegas[k]) for k in best]


def _refined(t: Array, u: Array, modes: Modes) -> Modes:
    """Least squares from a guess; frequencies stay positive, growth is bounded."""
    scale = 2.0 * np.pi / t[-1]
    start = np.array(modes).ravel() / scale
    low = np.tile([0.1, -1.0], len(modes))
    high = np.tile([1.2 * _HIGHEST, 20.0], len(modes))
    solved = least_squares(
        lambda p: _residual(t, u, _pairs(p * scale)),
        np.clip(start, low + 1e-6, high - 1e-6),
        jac="3-point",
        bounds=(low, high),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
        max_nfev=60,
    )
    return _pairs(solved.x * scale)


def _pairs(flat: Array) -> Modes:
    return [(float(w), float(d)) for w, d in flat.reshape(-1, 2)]


def _summary(t: Array, u: Array, modes: Modes) -> DampedFit:
    coefficients = _coefficients(t, u, modes)
    errors = _decrement_errors(t, u, modes)
    found = [
        Mode(
            period=2.0 * np.pi / omega,
            decrement=2.0 * np.pi * delta / omega,
            amplitude=float(np.hypot(*coefficients[2 * k + 1 : 2 * k + 3])),
        )
        for k, (omega, delta) in enumerate(modes)
    ]
    order = sorted(range(len(found)), key=lambda k: -found[k].amplitude)
    left = _residual(t, u, modes)
    return DampedFit(
        constant=float(coefficients[0]),
        first=found[order[0]],
        second=found[order[1]],
        residual=float(np.abs(left).max()),
        rms=float(np.sqrt(np.mean(left**2))),
        decrement_error=float(errors[order[0]]),
    )


def _decrement_errors(t: Array, u: Array, modes: Modes) -> Array:
    """(m,) standard errors of the decrements 2π δ/ω.

    The covariance s² (JᵀJ)⁻¹ of (ω, δ), J by central differences of the projected residual, times
    (1 + r)/(1 − r), r the correlation of neighbouring residuals: samples that err alike count less.
    """
    flat = np.array(modes).ravel()
    step = 1e-6 / t[-1]
    slopes = [
        (_residual(t, u, _pairs(flat + e)) - _residual(t, u, _pairs(flat - e))) / (2.0 * step)
        for e in step * np.eye(len(flat))
    ]
    J = np.stack(slopes, axis=1)
    left = _residual(t, u, modes)
    power = float(left @ left)
    alike = float(np.clip(left[1:] @ left[:-1] / power, 0.0, 0.999)) if power > 0.0 else 0.0
    freedom = max(len(t) - 2 * len(flat) - 1, 1)
    variance = power / freedom * (1.0 + alike) / (1.0 - alike)
    covariance = variance * np.linalg.pinv(J.T @ J)
    errors = []
    for k, (omega, delta) in enumerate(modes):
        slope = np.array([-2.0 * np.pi * delta / omega**2, 2.0 * np.pi / omega])
        part = covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        errors.append(np.sqrt(max(slope @ part @ slope, 0.0)))
    return np.array(errors)
