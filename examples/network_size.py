"""Which network learns a plant cell's stress best: cross-validation and grid search.

`python examples/network_size.py` prints a table.
"""

import numpy as np
from sklearn.model_selection import GridSearchCV

from surrofe2 import CellParameters, RveLaw, SamplingRange, sample_stress
from surrofe2.adapters.scikit_learn import StressSurrogate

RANGE = SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=0.01)  # of the paper's bar
SIZES = {"hidden": [(4,), (12,), (12, 12), (24, 24)], "baseline_degree": [1, 3]}


def search_of(cell, count, sizes=SIZES, **training):
    """A grid search over sizes, three folds, on `count` true stresses with their tangents."""
    samples = sample_stress(RveLaw(cell), RANGE, count).valid
    X = np.hstack([samples.F.reshape(-1, 4), samples.F_dot.reshape(-1, 4)])
    y = samples.stress.reshape(-1, 4)
    search = GridSearchCV(StressSurrogate(cell, **training), sizes, cv=3)
    return search.fit(X, y, P_by_F=samples.P_by_F, P_by_F_dot=samples.P_by_F_dot)


def main():
    """Search and print the share of the stress's variance that each size leaves unexplained."""
    found = search_of(CellParameters.preset("water"), 2048, iterations=300).cv_results_
    print("network, polynomial: 1 − R², seconds a fit")
    for k in np.argsort(-found["mean_test_score"]):
        size, left = found["params"][k], 1.0 - found["mean_test_score"][k]
        seconds = found["mean_fit_time"][k]
        print(f"{size['hidden']}, {size['baseline_degree']}: {left:.1e}, {seconds:.1f}")


if __name__ == "__main__":
    main()
