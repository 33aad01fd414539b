"""Which network learns a plant cell's stress best: cross-validation and grid search.

`python examples/network_size.py` prints a table.
"""

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.model_selection import GridSearchCV

from surrofe2 import (
    CellParameters,
    RveLaw,
    SamplingRange,
    StressSamples,
    TrainingSettings,
    sample_stress,
    train,
)

RANGE = SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=0.01)  # of the paper's bar
SIZES = {"hidden": [(4,), (12,), (12, 12), (24, 24)], "baseline_degree": [1, 3]}


class StressRegressor(RegressorMixin, BaseEstimator):
    """A surrogate of the stress as a regressor of scikit-learn.

    Rows of X are F and Ḟ by rows (n, 8), those of y the Cauchy stress (n, 4); `fit` also takes the
    tangents (n, 2, 2, 2, 2), which make the same rows worth many more.
    """

    def __init__(self, cell, hidden=(24, 24), baseline_degree=3, iterations=1000, seed=0):
        self.cell, self.hidden, self.baseline_degree = cell, hidden, baseline_degree
        self.iterations, self.seed = iterations, seed

    def fit(self, X, y, P_by_F=None, P_by_F_dot=None):
        """Train on all rows but a held-out tenth."""
        F, F_dot = np.split(X.reshape(-1, 4, 2), 2, axis=1)
        samples = StressSamples(
            F=F,
            F_dot=F_dot,
            stress=y.reshape(-1, 2, 2),
            status=np.zeros(len(F), dtype=np.int8),
            cell=self.cell,
            initialisation="constrained-runs",
            range=RANGE,
            seed=0,
            P_by_F=P_by_F,
            P_by_F_dot=P_by_F_dot,
        )
        settings = {key: value for key, value in self.get_params().items() if key != "cell"}
        self.law_ = train(samples, TrainingSettings(**settings))
        return self

    def predict(self, X):
        """Stress (m, 4) in µN/µm, beyond the data too."""
        return self.law_.extrapolate(*np.split(X.reshape(-1, 4, 2), 2, axis=1)).reshape(-1, 4)


def search_of(cell, count, sizes=SIZES, **training):
    """A grid search over sizes, three folds, on `count` stresses by RVEs with their tangents."""
    samples = sample_stress(RveLaw(cell), RANGE, count).valid
    X = np.hstack([samples.F.reshape(-1, 4), samples.F_dot.reshape(-1, 4)])
    y = samples.stress.reshape(-1, 4)
    search = GridSearchCV(StressRegressor(cell, **training), sizes, cv=3)
    return search.fit(X, y, P_by_F=samples.P_by_F, P_by_F_dot=samples.P_by_F_dot)


def main():
    """Search and print the fraction of the stress's variance that each size leaves unexplained."""
    results = search_of(CellParameters.preset("water"), 2048, iterations=300).cv_results_
    print("network, polynomial: 1 − R², seconds per fit")
    for k in np.argsort(-results["mean_test_score"]):
        size = results["params"][k]
        unexplained = 1.0 - results["mean_test_score"][k]
        seconds = results["mean_fit_time"][k]
        print(f"{size['hidden']}, {size['baseline_degree']}: {unexplained:.1e}, {seconds:.1f}")


if __name__ == "__main__":
    main()
