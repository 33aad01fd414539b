"""Where a recipe leaves out how many samples there are, training takes as many as it needs."""

import json
from contextlib import contextmanager
from unittest.mock import Mock

import numpy as np
import pytest

from surrofe2.recipe import recipe as recipes
from surrofe2.recipe.recipe import load_recipe
from surrofe2.run.loop import no_stage
from surrofe2.store.hdf5 import read_seconds
from surrofe2.store.samples import read_data_set, stored_count
from surrofe2.store.surrogates import read_surrogate
from surrofe2.surrogate import training
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.refine import refine_surrogate
from surrofe2.workflow.train import train_surrogate
from tests.conftest import RECIPE, changed

MET, NEVER = 1e3, 1e-12
INTERRUPTIONS = [("train", 6), ("generate", 3)]


@pytest.fixture(autouse=True)
def _few(monkeypatch, stand_in):
    """Training begins with 40 samples, takes 160 at most, and is asked every tenth iteration."""
    stand_in()
    monkeypatch.setitem(generate_data_set.__kwdefaults__, "chunk", 16)
    monkeypatch.setattr(recipes, "FIRST_COUNT", 40)
    monkeypatch.setattr(recipes, "MOST_COUNT", 160)
    monkeypatch.setattr(training, "ROUND", 10)
    monkeypatch.setattr(training, "_ITERATIONS_AT_ONCE", 10)


@pytest.fixture
def wanting(changed_recipe):
    """wanting(bound): the small recipe without a number of samples, whose training wants it."""
    return lambda bound: load_recipe(
        changed_recipe("count = 40\n", "", "interval = 20", f"interval = 10\nbound = {bound}")
    )


def shown(stage):
    """Names and totals of the stages of a display."""
    return [call.args[:2] for call in stage.call_args_list]


def same(path, other):
    mine, theirs = read_surrogate(path), read_surrogate(other)
    assert mine.data_fingerprint == theirs.data_fingerprint
    weights = mine.network.tensors, theirs.network.tensors
    return all(np.array_equal(weights[0][name], weights[1][name]) for name in weights[0])


def test_the_first_samples_suffice(wanting):
    recipe = wanting(MET)
    assert len(generate_data_set(recipe.study()).samples.F) == 40
    stage = Mock(wraps=no_stage)
    trained = train_surrogate(recipe.study(), stage=stage)
    assert shown(stage) == [("train", 40), ("calibrate", 1.0)]
    assert stored_count(recipe.study().data_path()) == (40, True, True)
    assert (
        trained.surrogate.data_fingerprint == read_data_set(recipe.study().data_path()).fingerprint
    )


def test_more_are_taken_until_they_do_not_help(wanting, written, monkeypatch):
    recipe = wanting(NEVER)
    generate_data_set(recipe.study())
    stage = Mock(wraps=no_stage)
    monkeypatch.setattr("surrofe2.workflow.train._HELPS", np.inf)
    trained = train_surrogate(recipe.study(), stage=stage)
    told = [("train", 40), ("generate", 80), ("train", 40), ("generate", 160), ("train", 40)]
    assert shown(stage) == [*told, ("calibrate", 1.0)]
    samples = read_data_set(recipe.study().data_path())
    assert len(samples.F) == 160
    assert trained.surrogate.data_fingerprint == samples.fingerprint
    assert trained.surrogate.seconds["data"] == pytest.approx(
        read_seconds(recipe.study().data_path())
    )
    # all of them are what a stated number gives
    text = recipe.path.read_text(encoding="utf-8")
    text = changed(text, "cells.", "stated.", "seed = 3", "seed = 3\ncount = 160")
    stated = load_recipe(written(text, "stated.toml"))
    generate_data_set(stated.study())
    assert read_data_set(stated.study().data_path()).fingerprint == samples.fingerprint


def test_more_that_do_not_help_are_the_last(wanting, monkeypatch):
    recipe = wanting(NEVER)
    generate_data_set(recipe.study())
    monkeypatch.setattr("surrofe2.workflow.train._HELPS", 1e-30)
    train_surrogate(recipe.study())
    assert stored_count(recipe.study().data_path()) == (80, True, True)


def test_what_is_there_is_kept(wanting, invoke):
    recipe = wanting(NEVER)
    for _ in range(2):
        invoke("generate", recipe.path)
        invoke("train", recipe.path)
    there = stored_count(recipe.study().data_path()).rows
    assert there > 40
    again = invoke("generate", recipe.path)
    assert f"{there} samples (already finished)" in again.stdout
    assert "(already trained)" in invoke("train", recipe.path).stdout
    invoke("generate", recipe.path, "--fresh")
    assert stored_count(recipe.study().data_path()) == (40, True, True)


def stopping(where, at):
    """A display whose report ends the call at the number `at` of the reports of stages so named."""
    left = [at]

    @contextmanager
    def stage(what, total, unit):
        def report(done, note):
            left[0] -= what == where
            if left[0] < 0 and what == where:
                raise KeyboardInterrupt

        yield report

    return stage


@pytest.fixture
def whole(wanting, monkeypatch):
    """(recipe without a surrogate, the file of one made in one go, from twice as many samples)."""
    monkeypatch.setattr(recipes, "MOST_COUNT", 80)
    monkeypatch.setattr("surrofe2.workflow.train._HELPS", np.inf)
    recipe = wanting(NEVER)
    generate_data_set(recipe.study())
    path = train_surrogate(recipe.study()).path.rename(recipe.path.with_name("whole-surrogate.h5"))
    generate_data_set(recipe.study(), fresh=True)
    return recipe, path


@pytest.mark.parametrize(("where", "at"), INTERRUPTIONS)
def test_interrupted_it_goes_on_to_the_bit(whole, where, at):
    recipe, path = whole
    with pytest.raises(KeyboardInterrupt):
        train_surrogate(recipe.study(), stage=stopping(where, at))
    there = stored_count(recipe.study().data_path())
    if where == "generate":
        assert there == (min(40 + 16 * at, 80), at == 0, True)
    assert same(path, train_surrogate(recipe.study()).path)


@pytest.mark.parametrize(("command", "stated_first"), [("train", True), ("generate", False)])
def test_samples_of_a_stated_number_and_of_none_are_not_the_same(
    wanting, written, invoke, recipe, command, stated_first
):
    """Though there are as many."""
    if stated_first:
        generate_data_set(recipe.study())
        wanting(MET)
    else:
        generate_data_set(wanting(MET).study())
        written(RECIPE)
    refused = invoke(command, recipe.path, code=1)
    assert "cells.h5: samples.count: " in refused.stderr


def test_refining_knows_what_its_surrogate_learnt_from(wanting, changed_recipe):
    """The data set grows, and after that samples of the surrogate are a part of them."""
    changed_recipe("duration = 4.0", "duration = 0.5")
    recipe = wanting(NEVER)
    refine_surrogate(recipe, recipe.path.with_name("refined"), rounds=1)
    there = stored_count(recipe.study().data_path()).rows
    assert there > 40
    assert rounds_of(recipe)[0]["samples"] == there
    generate_data_set(recipe.study(), count=160)
    refine_surrogate(recipe, recipe.path.with_name("refined"), rounds=1, fresh=True)
    assert rounds_of(recipe)[0]["samples"] == there


def rounds_of(recipe):
    return json.loads((recipe.path.parent / "refined" / "refine.json").read_text())["rounds"]


def test_a_bound_that_is_infinite_wants_no_more_samples(wanting, monkeypatch):
    monkeypatch.setattr("surrofe2.workflow.train.shaped_bound", lambda *_: np.inf)
    recipe = wanting(NEVER)
    generate_data_set(recipe.study())
    train_surrogate(recipe.study())
    assert stored_count(recipe.study().data_path()).rows == 40
