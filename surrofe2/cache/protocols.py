"""What a cache asks of its surrogate, its fallback and the fallback's state."""

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

MOST_SPREAD = 2.0
"""Of trained surrogates the ratio is within 1 ± 0.01."""
_PROBE = 0.1  # of the range: within it moduli are constant enough


OnTrueAnswer = Callable[[Array, Array, Array, NDArray[np.int8], NDArray[np.int8]], None]
"""Takes every RVE answer that a run has paid for, at accepted steps: F, Ḟ and stress (n, 2, 2),
status (n,), and why (n,): 0 fallback, 1 audit."""


class Surrogate(Protocol):
    """A stress that is quick to look up, and says where it may not be used."""

    @property
    def cell(self) -> CellParameters:
        """Parameters of the plant cell whose stress was learnt."""

    @property
    def initialisation(self) -> str:
        """How its RVE was initialised."""

    @property
    def density(self) -> float | Array:
        """Mass per reference area, ng/µm²."""

    @property
    def range(self) -> SamplingRange | None:
        """Bounds outside which there is no answer, to say what left them; None: not known."""

    @property
    def stress_spread(self) -> float:
        """Spread of the stress, µN/µm: the unit of the user's tolerance."""

    @property
    def is_calibrated(self) -> bool:
        """Whether the risk of `lookup` is known by now; else it is infinite."""

    @property
    def has_tangents(self) -> bool:
        """Whether `tangents` answers."""

    def with_tolerance(self, tolerance: float, relative: float) -> Surrogate:
        """The same, whose risks are by this tolerance; shares of the spread, and of the local
        stress. An infinite tolerance leaves no risk. The surrogate itself stays as it is; one that
        learns shares what it learns with the other, but not the tolerance."""

    def local_tolerance(self, F: Array, F_dot: Array) -> Array:
        """(n,) what an error may be, as a fraction of the tolerance, at most 1."""

    def lookup(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """(stress (n, 2, 2) in µN/µm, status (n,), risk (n,)) in one pass; pure.

        The risk is the bound of the error over the error allowed at the point.

        Input is contiguous float64 (n, 2, 2), else unchecked: status 0 only where it is finite,
        det F > 0, the point is in range and the risk is at most `limit`.
        """

    def status_and_risk(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[NDArray[np.int8], Array]:
        """Return those of `lookup`, for less where no stress is needed."""

    def tangents(self, F: Array, F_dot: Array) -> Tangents:
        """Of the stress of `lookup`, for implicit macro steps; InputError where it has none."""


class Fallback(ResumableLaw, Protocol):
    """The law of RVEs of the same plant cell.

    Its states are values of n points, never changed in place, or None: `take(indices)` and
    `put(indices, state)` give others, and `left_points` (n,) is where the stress is one of several,
    beyond a bifurcation.
    """

    @property
    def cell(self) -> CellParameters:
        """Parameters of the plant cell."""

    @property
    def initialisation(self) -> str:
        """How its RVE is initialised."""


def check_parts(surrogate: Surrogate, fallback: Fallback) -> None:
    """A MismatchError unless both are of one plant cell and initialisation, and where the spread of
    stress that the surrogate states, the unit of tolerances, is more than `MOST_SPREAD` times what
    the fallback's moduli at rest give over its range.

    Audits by a tolerance that is too large would find nothing. The moduli are differences of the
    stress over a tenth of the range; of states that are uniform in it, a linear law's stress has
    the spread √(Σ (∂σ/∂c w)²/3) over the seven entries c of U and RᵀḞ with half widths w.
    """
    for what, here, there in (
        ("cell parameters", surrogate.cell.fingerprint, fallback.cell.fingerprint),
        ("initialisation", surrogate.initialisation, fallback.initialisation),
    ):
        if here != there:
            raise MismatchError(
                f"cache: the surrogate is of {what} {here}, the fallback of {there}; train a "
                "surrogate for the fallback's"
            )
    if surrogate.range is None:
        return
    low, high = surrogate.range.stretch
    stretch = _PROBE * max(abs(low - 1.0), abs(high - 1.0))
    shear = _PROBE * surrogate.range.shear
    rate = _PROBE * surrogate.range.rate
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
