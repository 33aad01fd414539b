"""Interfaces that a cache needs: its surrogate, its fallback and the fallback's state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.base.errors import MismatchError
from surrofe2.base.sampling import SamplingRange
from surrofe2.law.stress_law import ResumableLaw, Tangents
from surrofe2.plant_cell.parameters import CellParameters

# A surrogate's stated spread of stress over that by the RVE's moduli may be so much; of trained
# surrogates the ratio is within 1 ± 0.01.
MOST_SPREAD = 2.0
# Fraction of the range over which stresses are differenced: within it moduli are constant enough.
_PROBE = 0.1


# A function that takes every RVE answer that a run has paid for, at accepted steps: F, Ḟ and stress
# (n, 2, 2), status (n,), and why it was solved (n,): 0 as the fallback, 1 for an audit.
OnTrueAnswer = Callable[[Array, Array, Array, NDArray[np.int8], NDArray[np.int8]], None]


class Surrogate(Protocol):
    """A stress that is quick to look up, and knows where it may not be used."""

    @property
    def cell(self) -> CellParameters:
        """Parameters of the plant cell whose stress was learnt."""

    @property
    def initialisation(self) -> str:
        """Initialisation of the RVE that was learnt, as of `RveLaw`."""

    @property
    def density(self) -> float | Array:
        """Mass per reference area, ng/µm²."""

    @property
    def range(self) -> SamplingRange | None:
        """Bounds of strain and rate outside which there is no answer; None: not known."""

    @property
    def stress_spread(self) -> float:
        """Spread of the stress, µN/µm: the unit of the user's tolerance."""

    @property
    def is_calibrated(self) -> bool:
        """True once the risk of `lookup` is known; before that it is infinite."""

    @property
    def has_tangents(self) -> bool:
        """True if `tangents` has an answer."""

    def with_tolerance(self, tolerance: float, relative: float) -> Surrogate:
        """Return the same surrogate with risks by this tolerance; this one stays as it is.

        Args:
            tolerance: allowed error, as a fraction of the spread of stress; inf: no risk is left.
            relative: allowed error, as a fraction of the local stress, where that is less.

        A surrogate that learns shares with the other what it learns, but not the tolerance.
        """

    def local_tolerance(self, F: Array, F_dot: Array) -> Array:
        """Return (n,) the error allowed at a point, as a fraction of the tolerance, at most 1."""

    def lookup(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """Look up the stress and its risk at n points in one pass; pure.

        Args:
            F, F_dot: contiguous float64 (n, 2, 2), else unchecked.
            limit: largest risk that is trusted.

        Returns:
            stress (n, 2, 2) in µN/µm; status (n,), 0 only where the input is finite, det F > 0, the
            point is in range and the risk is at most `limit`; risk (n,), the bound of the error
            over the error allowed at the point.
        """

    def status_and_risk(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[NDArray[np.int8], Array]:
        """Return status and risk as `lookup` does, for less where no stress is needed."""

    def tangents(self, F: Array, F_dot: Array) -> Tangents:
        """Compute the derivatives of the stress of `lookup`; InputError where it has none."""


class Fallback(ResumableLaw, Protocol):
    """The law of RVEs of the same plant cell.

    Its states are values of n points, never changed in place, or None. `take(indices)` and
    `put(indices, state)` return others; `left_points` (n,) says where the stress is one of several,
    beyond a bifurcation.
    """

    @property
    def cell(self) -> CellParameters:
        """Parameters of the plant cell."""

    @property
    def initialisation(self) -> str:
        """Initialisation of its RVE, as of `RveLaw`."""


def check_parts(surrogate: Surrogate, fallback: Fallback) -> None:
    """Check that a surrogate and a fallback belong together.

    The unit of tolerances is the spread of stress that the surrogate states. If it were too large,
    audits would find nothing. So it is compared with the spread that the fallback's moduli at rest
    give: of states that are uniform in the range, a linear law's stress has the spread
    √(Σ (∂σ/∂c w)²/3), summed over the seven entries c of U and RᵀḞ with half widths w of the range.
    The moduli are differences of the stress over a tenth of the range.

    Raises:
        MismatchError: they are not of one plant cell and initialisation, or the surrogate's spread
            is more than `MOST_SPREAD` times that of the moduli.
    """
    for what, of_surrogate, of_fallback in (
        ("cell parameters", surrogate.cell.fingerprint, fallback.cell.fingerprint),
        ("initialisation", surrogate.initialisation, fallback.initialisation),
    ):
        if of_surrogate != of_fallback:
            raise MismatchError(
                f"cache: the surrogate is of {what} {of_surrogate}, the fallback of "
                f"{of_fallback}; train a surrogate for the fallback's"
            )
    if surrogate.range is None:
        return
    low, high = surrogate.range.stretch
    stretch = _PROBE * max(abs(low - 1.0), abs(high - 1.0))
    shear = _PROBE * surrogate.range.shear
    rate = _PROBE * surrogate.range.rate
    # the state at rest, and one with each of the three strains and four rates
    F = np.tile(np.eye(2), (8, 1, 1))
    F_dot = np.zeros((8, 2, 2))
    F[1, 0, 0] += stretch
    F[2, 1, 1] += stretch
    F[3] += [[0.0, shear], [shear, 0.0]]
    F_dot[4:] = rate * np.eye(4).reshape(4, 2, 2)
    answer = fallback.respond(F, F_dot)
    if answer.status.any():
        return  # the range begins beyond what the cell bears; audits alone can tell
    squares = ((answer.stress[1:] - answer.stress[0]) ** 2).sum() / _PROBE**2
    spread = float(np.sqrt(squares / 3.0))
    if surrogate.stress_spread > MOST_SPREAD * spread:
        raise MismatchError(
            f"cache: the surrogate states a spread of stress of {surrogate.stress_spread:.3g} "
            f"µN/µm, by the moduli of the RVE it is {spread:.3g}; train it again, for tolerances "
            "are shares of it"
        )
