"""A surrogate as a regressor: scikit-learn's own checks, cross-validation, files but no pickles."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest
import torch
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, cross_val_score
from sklearn.utils.estimator_checks import check_estimator

from surrofe2 import CellParameters, TrainingSettings, train
from surrofe2.adapters import scikit_learn
from surrofe2.adapters.scikit_learn import StressSurrogate
from surrofe2.errors import InputError
from tests.laws import lattice_samples, lattice_stress, tangents_by_differences

SMALL = {"hidden": (4,), "baseline_degree": 2, "iterations": 40}
FEW = "the check has fewer rows than a training needs, 20"
NOT_ONE = "the check's y is one column, the prediction four"
PICKLE = "a fitted one is not pickled: loading a pickle runs code; save and load write files"
CANNOT_HOLD = {
    "check_fit_score_takes_y": NOT_ONE,
    "check_pipeline_consistency": NOT_ONE,
    "check_regressors_train": NOT_ONE,
    "check_n_features_in_after_fitting": FEW,
    "check_estimators_nan_inf": FEW,
    "check_regressor_multioutput": FEW,
    "check_regressors_no_decision_function": FEW,
    "check_fit2d_1feature": FEW,
    "check_fit2d_1sample": FEW,
    "check_estimators_pickle": PICKLE,
}


@pytest.fixture(scope="module", autouse=True)
def one_torch_thread():
    """Small networks gain nothing from more."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def rows():
    samples = lattice_samples(300)
    return rows_of(samples.F, samples.F_dot), samples.stress.reshape(-1, 4), samples


def rows_of(F, F_dot):
    return np.hstack([F.reshape(-1, 4), F_dot.reshape(-1, 4)])


def test_checks_of_scikit_learn_fail_for_their_columns_alone():
    """They feed one to ten columns of numbers that are no deformations."""
    found = check_estimator(StressSurrogate(**SMALL), on_fail=None, on_skip=None)
    assert sum(each["status"] == "passed" for each in found) > 20
    for each in found:
        if each["status"] == "failed":
            reason = told(each["exception"])
            assert re.search("columns?; it must have 8", reason), reason


def told(error):
    """What an exception and those behind it say."""
    lines = []
    while error is not None:
        lines.append(str(error))
        error = error.__cause__ or error.__context__
    return "\n".join(lines)


def test_checks_of_scikit_learn_hold_where_their_columns_are_made_deformations(monkeypatch):
    """Any columns bent to F within 5 % of I and rates, any y repeated to four; else all is ours."""

    def deformations(X):
        x = np.tanh(X[:, np.arange(8) % X.shape[1]]).reshape(-1, 4, 2)
        F, F_dot = np.split(x, 2, axis=1)
        return np.eye(2) + 0.05 * F, np.ascontiguousarray(0.01 * F_dot)

    def stresses(y):
        y = np.asarray(y, dtype=float).reshape(len(y), -1)
        return y[:, np.arange(4) % y.shape[1]].reshape(-1, 2, 2)

    monkeypatch.setattr(scikit_learn, "_deformations", deformations)
    monkeypatch.setattr(scikit_learn, "_stresses", stresses)
    estimator = StressSurrogate(hidden=(3,), baseline_degree=1, iterations=2)
    found = check_estimator(
        estimator, expected_failed_checks=CANNOT_HOLD, on_fail=None, on_skip=None
    )
    failed = {each["check_name"]: told(each["exception"]) for each in found
              if each["status"] == "failed"}  # fmt: skip
    assert not failed
    assert {each["check_name"] for each in found if each["status"] == "xfail"} == set(CANNOT_HOLD)
    assert sum(each["status"] == "passed" for each in found) > 35


def test_fit_is_train(rows):
    X, y, samples = rows
    model = StressSurrogate(**SMALL).fit(X, y)
    law = train(samples, TrainingSettings(**SMALL))
    F, F_dot = samples.F[:50], samples.F_dot[:50]
    spread = y.std(axis=0).max()
    assert model.predict(X[:50]).shape == (50, 4)
    difference = model.predict(X[:50]).reshape(-1, 2, 2) - law.extrapolate(F, F_dot)
    assert np.abs(difference).max() < 2e-3 * spread  # their ranges, and so their scales, differ
    assert model.score(X, y) > 0.999
    assert model.law_.in_range(F, F_dot).mean() > 0.8
    assert model.errors_["points"] == 30


def test_tangents_make_few_rows_worth_many(rows):
    X, y, samples = rows
    few = np.arange(45)  # for 60 coefficients a component
    exact = tangents_by_differences(lattice_stress, samples.F[few], samples.F_dot[few])
    model = StressSurrogate(iterations=0)
    without = cross_val_score(model, X[few], y[few], cv=3).mean()
    params = {"P_by_F": exact.P_by_F, "P_by_F_dot": exact.P_by_F_dot}
    with_them = cross_val_score(model, X[few], y[few], cv=3, params=params).mean()
    assert 1.0 - with_them < 0.3 * (1.0 - without)


def test_a_grid_search_finds_the_size(rows):
    X, y, _ = rows
    search = GridSearchCV(
        StressSurrogate(**SMALL), {"hidden": [(1,), (8,)], "baseline_degree": [1]}, cv=2
    ).fit(X, y)
    assert search.best_params_["hidden"] == (8,)
    assert search.best_estimator_.law_.settings.hidden == (8,)


def test_parameters_clone_and_travel_to_processes():
    cell = CellParameters.preset("water", wall_stiffness=3000.0)
    model = StressSurrogate(cell, hidden=(5, 5)).set_params(seed=3)
    for twin in (clone(model), pickle.loads(pickle.dumps(model))):
        assert twin.get_params() == model.get_params()
    assert twin.get_params()["cell"] == cell


def test_files_keep_a_fitted_one_and_pickles_do_not(rows, tmp_path):
    X, y, _ = rows
    model = StressSurrogate(**SMALL, seed=4).fit(X, y)
    with pytest.raises(TypeError, match="runs whatever code it names; write it by save"):
        pickle.dumps(model)
    model.save(tmp_path / "model.safetensors")
    again = StressSurrogate.load(tmp_path / "model.safetensors")
    assert (again.predict(X) == model.predict(X)).all()
    assert again.score(X, y) == model.score(X, y)
    cell, params = again.get_params().pop("cell"), clone(model).get_params()
    assert cell == CellParameters.preset("printed")
    assert {**again.get_params(), "cell": "printed"} == params


@pytest.mark.parametrize(
    ("columns", "stresses", "message"),
    [
        (7, 4, "X: 7 columns; it must have 8, F and then its rate by rows: F11, F12"),
        (8, 3, r"y: shape \(300, 3\); it must have 4 columns, Cauchy stress by rows: s11"),
    ],
)
def test_columns_are_named(rows, columns, stresses, message):
    X, y, _ = rows
    with pytest.raises(InputError, match=message):
        StressSurrogate(**SMALL).fit(X[:, :columns], y[:, :stresses])


def test_what_is_no_deformation_or_no_cell_is_refused(rows):
    X, y, _ = rows
    with pytest.raises(InputError, match="det F = -1"):
        StressSurrogate(**SMALL).fit(X * np.where(np.arange(8) == 0, -1.0, 1.0), y)
    with pytest.raises(InputError, match="hidden: "):
        StressSurrogate(hidden=()).fit(X, y)
    with pytest.raises(InputError, match="preset"):
        StressSurrogate("wheat").fit(X, y)
