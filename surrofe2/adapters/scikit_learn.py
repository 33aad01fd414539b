"""A surrogate of a plant cell's stress as a regressor of scikit-learn.

A row of X is one deformation, F and then Ḟ by rows; a row of y is its Cauchy stress::

    X = (F₁₁, F₁₂, F₂₁, F₂₂, Ḟ₁₁, Ḟ₁₂, Ḟ₂₁, Ḟ₂₂),    y = (σ₁₁, σ₁₂, σ₂₁, σ₂₂)

`fit` is `surrofe2.train` on these rows. Cross-validation, grid search and `clone` work as on any
regressor, also in several processes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from surrofe2.errors import InputError
from surrofe2.io.surrogates import read_surrogate, write_surrogate
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange, range_holding
from surrofe2.stress_law import check_deformation
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.surrogate.surrogate_law import SurrogateLaw
from surrofe2.surrogate.training import train

Array = NDArray[np.float64]

COLUMNS = ("F11", "F12", "F21", "F22", "dF11", "dF12", "dF21", "dF22")
STRESSES = ("s11", "s12", "s21", "s22")
_AT_REST = SamplingRange(stretch=(1.0 - 1e-6, 1.0 + 1e-6), shear=0.0, rate=0.0)


class StressSurrogate(RegressorMixin, BaseEstimator):
    """σ(F, Ḟ) of one RVE, learnt from X (n, 8) of F and Ḟ in 1/µs and y (n, 4) in µN/µm.

    Args:
        cell: whose stress it is: a preset's name or `CellParameters`. Its arrangement tells the
            symmetry that the surrogate has exactly.
        initialisation: how its RVE was initialised.
        hidden, form, tangent_weight, baseline_degree, iterations, seed: as in `TrainingSettings`,
            whose defaults the others have.

    Attributes:
        law_: the `SurrogateLaw`; it has tangents, the range of the data and, once `calibrate` has
            been asked, a bound of its error.
        errors_: over the held-out tenth of the rows, see `SurrogateLaw`.
        n_features_in_: 8.
    """

    def __init__(
        self,
        cell: str | CellParameters = "printed",
        initialisation: str = "constrained-runs",
        hidden: tuple[int, ...] = (24, 24),
        tangent_weight: float = 0.1,
        baseline_degree: int = 3,
        iterations: int = 1000,
        seed: int = 0,
    ) -> None:
        self.cell = cell
        self.initialisation = initialisation
        self.hidden = hidden
        self.tangent_weight = tangent_weight
        self.baseline_degree = baseline_degree
        self.iterations = iterations
        self.seed = seed

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        P_by_F: ArrayLike | None = None,
        P_by_F_dot: ArrayLike | None = None,
    ) -> Self:
        """Train on all rows but a tenth, whose errors are `errors_`.

        Args:
            P_by_F, P_by_F_dot: tangents (n, 2, 2, 2, 2) as in `Tangents`, which make the same rows
                worth many more; give both or neither. `cross_validate` takes them as `params`.

        Raises:
            InputError: the columns are not eight and four, det F ≤ 0, or fewer than 20 rows.
        """
        rows, stress = validate_data(
            self, X, y, dtype=np.float64, multi_output=True, y_numeric=True
        )
        F, F_dot = _deformations(rows)
        cell = self.cell
        self.law_ = train(
            StressSamples(
                F=F,
                F_dot=F_dot,
                stress=_stresses(stress),
                status=np.zeros(len(F), dtype=np.int8),
                cell=cell if isinstance(cell, CellParameters) else CellParameters.preset(cell),
                initialisation=self.initialisation,
                range=range_holding(_AT_REST, F, F_dot),
                seed=0,
                P_by_F=_tangents(P_by_F),
                P_by_F_dot=_tangents(P_by_F_dot),
            ),
            TrainingSettings(
                hidden=self.hidden,
                tangent_weight=self.tangent_weight,
                baseline_degree=self.baseline_degree,
                iterations=self.iterations,
                seed=self.seed,
            ),
        )
        self.errors_ = self.law_.errors
        return self

    def predict(self, X: ArrayLike) -> Array:
        """Stress (m, 4) in µN/µm, beyond the data too; `law_.in_range(F, F_dot)` says where."""
        check_is_fitted(self)
        rows = validate_data(self, X, dtype=np.float64, reset=False)
        return self.law_.extrapolate(*_deformations(rows)).reshape(-1, 4)

    def save(self, path: str | Path) -> None:
        """Write the surrogate as `surrofe2 train` does, for runs and for `load`."""
        check_is_fitted(self)
        write_surrogate(self.law_, path)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """A fitted regressor from the file of any surrogate."""
        return cls.of(read_surrogate(path))

    @classmethod
    def of(cls, law: SurrogateLaw) -> Self:
        """A trained surrogate as a fitted regressor."""
        settings = law.settings
        found = cls(
            cell=law.cell,
            initialisation=law.initialisation,
            hidden=settings.hidden,
            tangent_weight=settings.tangent_weight,
            baseline_degree=settings.baseline_degree,
            iterations=settings.iterations,
            seed=settings.seed,
        )
        found.law_, found.errors_, found.n_features_in_ = law, law.errors, len(COLUMNS)
        return found

    def __getstate__(self) -> dict[str, Any]:
        if "law_" in self.__dict__:
            raise TypeError(
                "a fitted StressSurrogate is not pickled, since loading a pickle runs whatever "
                "code it names; write it by save(path) and read it by StressSurrogate.load(path)"
            )
        return super().__getstate__()

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output, tags.target_tags.multi_output = False, True
        return tags


def _deformations(X: Array) -> tuple[Array, Array]:
    """F and Ḟ, (n, 2, 2) each, of (n, 8)."""
    if X.shape[1] != len(COLUMNS):
        raise InputError(
            f"X: {X.shape[1]} columns; it must have 8, F and then its rate by rows: "
            f"{', '.join(COLUMNS)}"
        )
    return check_deformation(*np.split(X.reshape(-1, 4, 2), 2, axis=1))


def _stresses(y: Array) -> Array:
    """(n, 2, 2) of (n, 4)."""
    if np.shape(y)[1:] != (len(STRESSES),):
        raise InputError(
            f"y: shape {np.shape(y)}; it must have 4 columns, Cauchy stress by rows: "
            f"{', '.join(STRESSES)}"
        )
    return np.asarray(y, dtype=np.float64).reshape(-1, 2, 2)


def _tangents(given: ArrayLike | None) -> Array | None:
    return None if given is None else np.asarray(given, dtype=np.float64)
