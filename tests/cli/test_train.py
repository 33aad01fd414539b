import shlex

import pytest

from surrofe2.store.store import START_OVER
from surrofe2.store.surrogates import read_surrogate
from surrofe2.surrogate import training
from surrofe2.workflow import train as train_workflow
from surrofe2.workflow.train import large_errors, train_surrogate
from tests.laws import StoppingLaw


@pytest.mark.usefixtures("data_set")
def test_writes_the_surrogate_and_shows_its_errors(invoke, recipe_path, surrogate_path, recipe):
    done = invoke("train", recipe_path)
    assert "Held-out errors, 4 samples" in done.stdout
    last = done.stdout.splitlines()[-1]
    assert last.startswith(f"{surrogate_path}: held-out errors up to ")
    assert "worst, from 40 samples, " in last
    surrogate = read_surrogate(surrogate_path)
    assert (surrogate.cell, surrogate.range) == (recipe.cell, recipe.range)
    assert list(surrogate_path.parent.glob("*-surrogate.h5")) == [surrogate_path]


@pytest.mark.usefixtures("data_set")
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("hidden = [4]", "hidden = [5]"), "training.hidden: this call has [5], what is there [4]"),
        (("length = 6", "length = 7"), "calibration.length: this call has 7, what is there 6"),
    ],
)
def test_a_surrogate_of_other_settings_is_refused_unless_fresh(
    invoke, recipe_path, surrogate_path, changed_recipe, change, told
):
    invoke("train", recipe_path)
    before = surrogate_path.read_bytes()
    refused = invoke("train", changed_recipe(*change), code=1)
    assert refused.stderr == (f"error: {surrogate_path}: {told}; {START_OVER}\n")
    assert surrogate_path.read_bytes() == before
    invoke("train", recipe_path, "--fresh")
    assert surrogate_path.read_bytes() != before


@pytest.mark.usefixtures("data_set")
def test_interrupted_and_continued(invoke, recipe_path, surrogate_path, monkeypatch):
    figures, rounds = training._Minimisation.figures, []

    def interrupt_second(*arguments):
        rounds.append(1)
        if len(rounds) == 2:
            raise KeyboardInterrupt
        return figures(*arguments)

    monkeypatch.setattr(training._Minimisation, "figures", interrupt_second)
    stopped = invoke("train", recipe_path, code=130)
    assert stopped.stderr.splitlines()[-1] == (
        f"interrupted: the iterations so far are kept; resume with: surrofe2 train {recipe_path}"
    )
    unfinished = surrogate_path.with_suffix(".unfinished.h5")
    assert unfinished.exists()
    invoke("train", recipe_path)
    assert len(rounds) == 3
    assert not unfinished.exists()


@pytest.mark.usefixtures("data_set")
def test_a_new_training_that_ends_at_once_goes_on(
    invoke, recipe_path, changed_recipe, surrogate_path, monkeypatch
):
    """The command that it names works, though what is there is of other settings."""
    unfinished = surrogate_path.with_suffix(".unfinished.h5")
    invoke("train", recipe_path)
    unfinished.write_bytes(b"of another training")
    changed_recipe("hidden = [4]", "hidden = [5]")
    before = surrogate_path.read_bytes()

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("surrofe2.surrogate.training.train", interrupted)
        stopped = invoke("train", recipe_path, "--fresh", code=130)
    assert surrogate_path.read_bytes() == before
    told = stopped.stderr.splitlines()[-1].split("resume with: surrofe2 ")[1]
    assert told == f"train {recipe_path} --fresh"
    invoke(*shlex.split(told))
    assert read_surrogate(surrogate_path).settings.hidden == (5,)


@pytest.mark.usefixtures("data_set")
@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ('"printed"', '"water"', "cell.fluid_particle_mass"),
        ("count = 40", "count = 41", "samples.count"),
    ],
)
def test_data_set_of_another_recipe(invoke, recipe_path, changed_recipe, old, new, name):
    refused = invoke("train", changed_recipe(old, new), code=1)
    assert refused.stderr.startswith(
        f"error: {recipe_path.parent / 'cells.h5'}: {name}: this call "
    )
    assert f"surrofe2 generate {recipe_path} --fresh" in refused.stderr


def test_what_is_missing_names_the_command_that_makes_it(invoke, recipe_path):
    refused = invoke("train", recipe_path, code=1)
    assert f"make it with `surrofe2 generate {recipe_path}`" in refused.stderr


def test_unfinished_data_set(invoke, recipe_path, recipe):
    invoke("generate", recipe_path, law=StoppingLaw(0), code=130)
    refused = invoke("train", recipe_path, code=1)
    assert refused.stderr == (
        f"error: {recipe.data_path()}: unfinished, 0 of 40 samples; continue it with "
        "`surrofe2 generate RECIPE`\n"
    )


@pytest.mark.usefixtures("data_set")
def test_large_errors_are_told_with_what_to_do(invoke, recipe_path, recipe, monkeypatch):
    trained = train_surrogate(recipe)
    rms = trained.surrogate.errors["rms"]
    name = max(("xx", "xy", "yx", "yy"), key=lambda each: rms[each])
    monkeypatch.setattr(train_workflow, "LARGE_ERROR", rms[name])
    assert large_errors(recipe, trained) is None
    monkeypatch.setattr(train_workflow, "LARGE_ERROR", 0.999 * rms[name])
    told = large_errors(recipe, trained)
    assert f"the error of {name} is {100 * rms[name]:.2g} % RMS, from 40 usable samples" in told
    assert "surrofe2 check" in told
    assert "surrofe2 refine" in told
    assert told in invoke("train", recipe_path).stderr.splitlines()
