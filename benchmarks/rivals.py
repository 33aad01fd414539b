"""What a network has to beat: nearest neighbours, a Gaussian process, linear extrapolation.

The regressors read the scaled inputs of the network (U and RᵀḞ, so rotations are out) folded by
the square cell's group into difference ≥ 0 and shear ≥ 0, and answer in components of P̂ = RᵀP. So
they have the network's symmetries, though with an edge where the fold is. `StressTable` folds by
itself.
"""

from __future__ import annotations

import warnings
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF
from sklearn.neighbors import KNeighborsRegressor

from surrofe2.cache import StressTable
from surrofe2.rve import RveLaw
from surrofe2.square_symmetry import COMPONENT_SIGNS, INPUT_SIGNS, canonical_image
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate.features import input_scale
from surrofe2.surrogate.piola import to_cauchy, to_piola, to_slopes
from surrofe2.tensors import stress_spread, to_inputs

Array = NDArray[np.float64]

NEIGHBOURS = 8
TABLE_TOLERANCE = 1e-3  # of a `StressTable`, relative to the spread of stress
_SOLVES_A_RECORD = 8
_TUNED_ON = 512  # samples that the length scales of the Gaussian process are fitted to


class Regressor(Protocol):
    """Components of P̂ (n, 4) at folded inputs (n, 7)."""

    def fit(self, x: Array, P: Array, slopes: Array | None) -> None:
        """Learn from inputs, P̂ and, where there are any, its slopes (n, 4, 7)."""

    def predict(self, x: Array) -> Array:
        """P̂ (n, 4)."""


class Folded:
    """A regressor as a stress law of a square plant cell."""

    def __init__(self, regressor: Regressor, samples: StressSamples) -> None:
        valid = samples.valid
        self.scale = input_scale(samples.range)
        self.regressor = regressor
        x, signs_in, signs_out = fold(to_inputs(valid.F, valid.F_dot)[0] / self.scale)
        slopes = None
        if valid.P_by_F is not None and valid.P_by_F_dot is not None:
            slopes = to_slopes(valid.F, valid.P_by_F, valid.P_by_F_dot) * self.scale
            slopes = signs_out[:, :, None] * slopes * signs_in[:, None, :]
        regressor.fit(x, signs_out * to_piola(valid.F, valid.stress), slopes)

    def stress(self, F: Array, F_dot: Array) -> Array:
        """Cauchy stress (n, 2, 2)."""
        x, _, signs = fold(to_inputs(F, F_dot)[0] / self.scale)
        return to_cauchy(F, signs * self.regressor.predict(x))


def fold(x: Array) -> tuple[Array, Array, Array]:
    """(folded inputs, their signs (n, 7), signs of the components (n, 4))."""
    image = canonical_image(x)
    return x * INPUT_SIGNS[image], INPUT_SIGNS[image], COMPONENT_SIGNS[image]


class NearestNeighbours:
    """Mean of the nearest samples, weighted by the inverse of their distance."""

    def fit(self, x: Array, P: Array, slopes: Array | None) -> None:
        """See `Regressor`."""
        self.model = KNeighborsRegressor(min(NEIGHBOURS, len(x)), weights="distance").fit(x, P)

    def predict(self, x: Array) -> Array:
        """See `Regressor`."""
        return np.asarray(self.model.predict(x))


class GaussianProcess:
    """Squared exponentials with a length scale an input, shared by the components."""

    def fit(self, x: Array, P: Array, slopes: Array | None) -> None:
        """See `Regressor`."""
        self.spread = P.std(axis=0)
        kernel = RBF(np.full(x.shape[1], 4.0), (0.5, 1e3))
        first = GaussianProcessRegressor(kernel, alpha=1e-10)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # a length scale at its bound
            first.fit(x[:_TUNED_ON], (P / self.spread)[:_TUNED_ON])
        last = GaussianProcessRegressor(first.kernel_, alpha=1e-10, optimizer=None)
        self.model = last.fit(x, P / self.spread)

    def predict(self, x: Array) -> Array:
        """See `Regressor`."""
        return np.asarray(self.model.predict(x)) * self.spread


class LinearFromNearest:
    """The nearest sample, extrapolated by its exact tangents: a table without its ellipsoids."""

    def fit(self, x: Array, P: Array, slopes: Array | None) -> None:
        """See `Regressor`; slopes are needed."""
        assert slopes is not None
        self.tree, self.x, self.P, self.slopes = cKDTree(x), x, P, slopes

    def predict(self, x: Array) -> Array:
        """See `Regressor`."""
        k = self.tree.query(x)[1]
        step = np.einsum("nij,nj->ni", self.slopes[k], x - self.x[k])
        return np.asarray(self.P[k] + step)


def learn_table(law: RveLaw, samples: StressSamples) -> StressTable:
    """A table that has spent as many RVE solves as there are samples, a record about each 8th."""
    spread = stress_spread(samples.valid.stress)
    most = max(1, len(samples.F) // _SOLVES_A_RECORD)
    table = StressTable(law, TABLE_TOLERANCE * spread, samples.range, spread, most_records=most)
    valid = samples.valid
    table.learn(valid.F[:most], valid.F_dot[:most], valid.stress[:most])
    return table
