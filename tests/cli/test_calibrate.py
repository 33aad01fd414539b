"""What `train` does at its end: the bound of the error."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from surrofe2 import simulate
from surrofe2.errors import SimulationError
from surrofe2.io.files import plain
from surrofe2.io.surrogates import read_surrogate
from surrofe2.workflow import calibrate as calibrating
from tests.laws import SoftLaw

AT_REST = np.eye(2)[None], np.zeros((1, 2, 2))


@pytest.fixture
def surrogate_path(recipe_path):
    return recipe_path.parent / "cells.safetensors"


@pytest.fixture(autouse=True)
def _data_set(invoke, recipe_path):
    assert invoke("generate", recipe_path).exit_code == 0


def test_train_calibrates_and_says_what_it_found(invoke, recipe_path, surrogate_path, recipe):
    done = invoke("train", recipe_path)
    assert done.exit_code == 0, done.output
    line = next(line for line in done.stdout.splitlines() if line.startswith("bound: "))
    assert "% of the spread of stress at the centre" in line
    assert line.endswith("at the edge, 38 paths, nominal share 10 %")
    surrogate = read_surrogate(surrogate_path)
    assert surrogate.is_calibrated
    assert np.isfinite(surrogate.error_bound(*AT_REST)).all()
    calibration = surrogate.calibration
    counts = {kind: figures["paths"] for kind, figures in calibration.kinds.items()}
    assert counts == {"walks": 9, "states": 20, "runs": 9}
    assert calibration.settings == asdict(recipe.calibration)
    assert calibration.data_fingerprint == surrogate.data_fingerprint


def test_the_seed_decides(invoke, recipe_path, surrogate_path, changed_recipe):
    bounds = []
    for change in (
        ("seed = 3", "seed = 3"),
        ("seed = 3", "seed = 3"),
        ("length = 6", "length = 7"),
    ):
        assert invoke("train", changed_recipe(*change), "--fresh").exit_code == 0
        bounds.append(plain(read_surrogate(surrogate_path).calibration))
    assert bounds[0] == bounds[1]
    assert bounds[0] != bounds[2]


def test_interrupted_while_calibrating(invoke, recipe_path, surrogate_path, monkeypatch):
    respond, calls = SoftLaw.respond, []

    def interrupt(self, *arguments, **keywords):
        calls.append(1)
        if len(calls) == 5:
            raise KeyboardInterrupt
        return respond(self, *arguments, **keywords)

    monkeypatch.setattr(SoftLaw, "respond", interrupt)
    stopped = invoke("train", recipe_path)
    assert stopped.exit_code == 130
    assert f"go on with: surrofe2 train {recipe_path}\n" in stopped.stderr
    fresh = read_surrogate(surrogate_path)
    assert not fresh.is_calibrated
    trainings = []
    monkeypatch.setattr("surrofe2.workflow.train.train", lambda *_: trainings.append(1))
    done = invoke("train", recipe_path)
    assert done.exit_code == 0, done.output
    assert not trainings
    assert read_surrogate(surrogate_path).is_calibrated


def test_a_true_law_that_fails_everywhere_leaves_no_bound(
    invoke, recipe_path, surrogate_path, monkeypatch
):
    def failing(paths, law, progress):
        shape = (len(paths.states[0]), 2, 2)
        return np.full(shape, np.nan), np.ones(shape[0], dtype=np.int8)

    monkeypatch.setattr(calibrating, "true_stress", failing)
    monkeypatch.setattr("surrofe2.surrogate.calibration._failures", lambda shaping: None)
    done = invoke("train", recipe_path)
    assert done.exit_code == 0, done.output
    assert "bound: none, because the RVE has no stress on too many paths" in done.stdout
    assert np.isinf(read_surrogate(surrogate_path).error_bound(*AT_REST)).all()


def test_runs_whose_load_is_too_much_end_where_they_leave_the_range(recipe, invoke, recipe_path):
    assert invoke("train", recipe_path).exit_code == 0
    surrogate = read_surrogate(recipe.training_path())
    load = replace(recipe.load, body_force=(0.0, -50.0))
    met = calibrating._states_met(load, surrogate, recipe.macro)
    assert all(surrogate.in_range(F, F_dot).all() for F, F_dot in met)
    assert len(met) > 2
    with pytest.raises(
        SimulationError, match=r"after the rotation is taken out, .* beyond; .* outside the range"
    ):
        simulate(load, surrogate, recipe.macro)
