"""`train`, and the bound of the error at its end."""

import shlex
from dataclasses import asdict, replace
from unittest.mock import Mock

import numpy as np
import pytest

from surrofe2 import simulate
from surrofe2.base.errors import SimulationError
from surrofe2.problem.amplitude import Pulse, Ramp, Sine
from surrofe2.recipe.recipe import load_recipe
from surrofe2.store.samples import read_data_set
from surrofe2.store.store import START_OVER
from surrofe2.store.surrogates import read_surrogate
from surrofe2.surrogate import training
from surrofe2.surrogate.deformation_paths import Truth, random_walks
from surrofe2.workflow import train as train_workflow
from surrofe2.workflow.train import FACTOR, PACE, Varied, large_errors, varied_problems
from tests.conftest import LEARNING, changed
from tests.laws import SoftCell, SoftLaw, StoppingLaw
from tests.macro.bars import with_load

pytestmark = pytest.mark.usefixtures("data_set")


def test_writes_the_surrogate_and_shows_its_errors(invoke, recipe_path, surrogate_path, recipe):
    done = invoke("train", recipe_path)
    assert "Held-out errors, 4 samples" in done.stdout
    last = done.stdout.splitlines()[-1]
    assert last.startswith(f"{surrogate_path}: held-out errors up to ")
    assert "worst, from 40 samples, " in last
    surrogate = read_surrogate(surrogate_path)
    assert (surrogate.cell, surrogate.range) == (
        recipe.study().cell.parameters,
        recipe.study().cell.range,
    )
    assert list(surrogate_path.parent.glob("*-surrogate.h5")) == [surrogate_path]


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


def test_interrupted_and_continued(invoke, recipe_path, surrogate_path, monkeypatch):
    snapshot, rounds = training._snapshot, []

    def interrupt_second(identity, done, *arguments):
        rounds.append(done)
        if rounds == [0, 20, 40]:
            raise KeyboardInterrupt
        return snapshot(identity, done, *arguments)

    monkeypatch.setattr(training, "_snapshot", interrupt_second)
    stopped = invoke("train", recipe_path, code=130)
    assert stopped.stderr.splitlines()[-1] == (
        f"interrupted: the iterations so far are kept; resume with: surrofe2 train {recipe_path}"
    )
    unfinished = surrogate_path.with_suffix(".unfinished.h5")
    assert unfinished.exists()
    invoke("train", recipe_path)
    assert rounds == [0, 20, 40, 20, 40]
    assert not unfinished.exists()


def test_a_new_training_that_ends_at_once_goes_on(
    invoke, recipe_path, changed_recipe, surrogate_path, monkeypatch
):
    """The command that it names works, though what is there is of other settings."""
    unfinished = surrogate_path.with_suffix(".unfinished.h5")
    invoke("train", recipe_path)
    unfinished.write_bytes(b"of another training")
    changed_recipe("hidden = [4]", "hidden = [5]")
    before = surrogate_path.read_bytes()

    with monkeypatch.context() as patch:
        patch.setattr(training, "train", Mock(side_effect=KeyboardInterrupt))
        stopped = invoke("train", recipe_path, "--fresh", code=130)
    assert surrogate_path.read_bytes() == before
    told = stopped.stderr.splitlines()[-1].split("resume with: surrofe2 ")[1]
    assert told == f"train {recipe_path} --fresh"
    invoke(*shlex.split(told))
    assert read_surrogate(surrogate_path).settings.hidden == (5,)


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ('"printed"', '"water"', "cell.fluid_particle_mass"),
        ("count = 40", "count = 41", "samples.count"),
    ],
)
def test_data_set_of_another_recipe(invoke, recipe, changed_recipe, old, new, name):
    told = invoke("train", changed_recipe(old, new), code=1).stderr
    assert told.startswith(f"error: {recipe.study().data_path()}: {name}: this call ")
    assert f"surrofe2 generate {recipe.path} --fresh" in told


def test_what_is_missing_names_the_command_that_makes_it(invoke, recipe_path, recipe):
    recipe.study().data_path().unlink()
    refused = invoke("train", recipe_path, code=1)
    assert f"make it with `surrofe2 generate {recipe_path}`" in refused.stderr


def test_unfinished_data_set(invoke, recipe_path, recipe):
    recipe.study().data_path().unlink()
    invoke("generate", recipe_path, law=StoppingLaw(0), code=130)
    told = "unfinished, 0 of 40 samples; continue it with `surrofe2 generate RECIPE`\n"
    assert (
        invoke("train", recipe_path, code=1).stderr
        == f"error: {recipe.study().data_path()}: {told}"
    )


def test_large_errors_are_told_with_what_to_do(invoke, recipe_path, recipe, monkeypatch):
    trained = train_workflow.train_surrogate(recipe.study())
    rms = trained.surrogate.errors["rms"]
    name = max(("xx", "xy", "yx", "yy"), key=lambda each: rms[each])
    monkeypatch.setattr(train_workflow, "LARGE_ERROR", rms[name])
    assert large_errors(recipe.study(), trained) is None
    monkeypatch.setattr(train_workflow, "LARGE_ERROR", 0.999 * rms[name])
    told = large_errors(recipe.study(), trained)
    assert f"the error of {name} is {100 * rms[name]:.2g} % RMS, from 40 usable samples" in told
    assert "surrofe2 check" in told
    assert "surrofe2 refine" in told
    assert told in invoke("train", recipe_path).stderr.splitlines()


AT_REST = np.eye(2)[None], np.zeros((1, 2, 2))


def test_train_calibrates_and_says_what_it_found(invoke, recipe_path, surrogate_path, recipe):
    done = invoke("train", recipe_path)
    said = " ".join(done.stdout.split())
    assert "% of the stress spread at the centre of the range, " in said
    assert (
        " % at its edge; tolerance 0.1 % With 61 % confidence the bound covers 90 % of paths "
        in said
    )
    assert "the 9 walks and 9 runs that calibrated it; a safety factor of 1.5 is included" in said
    surrogate = read_surrogate(surrogate_path)
    assert surrogate.is_calibrated
    assert np.isfinite(surrogate.error_bound(*AT_REST)).all()
    calibration = surrogate.calibration
    counts = {kind: figures["paths"] for kind, figures in calibration.kinds.items()}
    assert counts == {"walks": 9, "runs": 9}
    assert calibration.confidence == pytest.approx(1.0 - 0.9**9)
    assert calibration.settings == asdict(recipe.calibration)
    assert calibration.data_fingerprint == surrogate.data_fingerprint


@pytest.mark.parametrize(("bound", "iterations"), [(10.0, 20), (1e-18, 40)])
def test_training_ends_when_the_bound_is_met(
    invoke, surrogate_path, changed_recipe, monkeypatch, bound, iterations
):
    """A bound that any surrogate keeps, and one that none does."""
    monkeypatch.setattr(training, "ROUND", 20)
    states, snapshot = [], training._snapshot

    def counted(*arguments):
        states.append(snapshot(*arguments))
        return states[-1]

    monkeypatch.setattr(training, "_snapshot", counted)
    path = changed_recipe("iterations = 40", f"iterations = 40\nbound = {bound}")
    invoke("train", path)
    assert states[-1].iterations == iterations
    surrogate = read_surrogate(surrogate_path)
    edge = train_workflow._edge(surrogate, read_data_set(load_recipe(path).study().data_path()))
    edge /= surrogate.stress_spread
    assert (edge <= bound) == (bound > 1.0)


def test_a_bound_without_paths_that_shape_it_is_refused(invoke, changed_recipe):
    path = changed_recipe("= 40\nche", "= 40\nbound = 1e-3\nche", "walks = 9", "walks = 0")
    refused = invoke("train", path, code=1)
    message = "training.bound: 0.001; it must be 0 where calibration.walks is"
    assert refused.stderr.splitlines()[-1] == f"error: {message}"


def test_paths_that_calibrate_are_drawn_by_the_samples(recipe, monkeypatch):
    """So a round of `refine` calibrates on none that chose its samples; those that shape stay."""
    walks = Mock(wraps=random_walks)
    monkeypatch.setattr(train_workflow, "random_walks", walks)
    samples = read_data_set(recipe.study().data_path())
    settings = replace(recipe.calibration, runs=0)
    for part in (samples, samples, samples.at(np.arange(30))):
        surrogate = training.train(part, replace(recipe.study().cell.training, iterations=0))
        train_workflow.calibrate(surrogate, part, SoftLaw(), settings)
    drawn = [call.args[1::2] for call in walks.call_args_list]  # counts and seeds
    (shaping, *shapings), (testing, *others) = drawn[::2], drawn[1::2]
    assert shapings == [shaping, shaping]
    assert others[0] == testing
    assert others[1] != testing


def test_interrupted_while_calibrating(invoke, recipe_path, surrogate_path, monkeypatch):
    stopped = invoke("train", recipe_path, law=StoppingLaw(4), code=130)
    assert f"resume with: surrofe2 train {recipe_path}\n" in stopped.stderr
    assert not read_surrogate(surrogate_path).is_calibrated
    monkeypatch.setattr(training, "train", Mock(side_effect=AssertionError))
    invoke("train", recipe_path)
    assert read_surrogate(surrogate_path).is_calibrated


def test_a_true_law_that_fails_everywhere_leaves_no_bound(
    invoke, recipe_path, surrogate_path, monkeypatch
):
    def failing(paths, law, progress=None):
        shape = (len(paths.states[0]), 2, 2)
        return Truth(paths, np.full(shape, np.nan), np.ones(shape[0], dtype=np.int8))

    monkeypatch.setattr(train_workflow, "true_stress", failing)
    monkeypatch.setattr("surrofe2.surrogate.calibration._failures", lambda shaping: None)
    done = invoke("train", recipe_path)
    assert "Error bound: none, because the RVE has no stress on too many paths" in done.stdout
    assert np.isinf(read_surrogate(surrogate_path).error_bound(*AT_REST)).all()


def test_runs_whose_load_is_too_much_end_where_they_leave_the_range(recipe, invoke, recipe_path):
    invoke("train", recipe_path)
    surrogate = read_surrogate(recipe.study().training_path())
    load = with_load(recipe.problem(), acceleration=(0.0, -50.0))
    (met,) = train_workflow._met_in_runs(surrogate, [load], recipe.macro, 1)
    assert all(surrogate.in_range(F, F_dot).all() for F, F_dot in met)
    assert len(met) > 2
    with pytest.raises(
        SimulationError, match=r"after the rotation is taken out, .* beyond; .* outside the range"
    ):
        simulate(load, surrogate, recipe.macro)


BLOCK = """
[mesh]
width = 100.0
height = 60.0
elements = [6, 1]
[conditions]
left = { kind = "symmetry", on = "left" }
bottom = { kind = "symmetry", on = "bottom" }
top = { kind = "symmetry", on = "top" }
[conditions.grip]
kind = "prescribed_motion"
on = "right"
displacement = [2.0, 0.0]
amplitude = { kind = "ramp", end = 20.0, smooth = true }
[time]
duration = 25.0
"""
"""It is stretched along x, 2 % in 20 µs."""
CELLS = """
[mesh.regions]
end = { box = [0.0, 0.0, 17.0, 60.0] }
[cells.end]
samples = { file = "end.h5" }
training = { file = "end-surrogate.h5" }
[cells.middle]
wall_stiffness = 8000.0
regions = ["rest"]
"""


def test_runs_of_a_stated_problem_are_its_own_with_other_loads(written, monkeypatch):
    """Pure stretch along x, which no bending bar meets; slower or faster, less or more."""
    recipe = load_recipe(written(LEARNING + BLOCK))
    monkeypatch.setattr(train_workflow, "simulate", recording := Mock(wraps=simulate))
    runs = list(train_workflow._runs(recipe.study(), SoftLaw(), 40, seed=3))
    problems = [call.args[0] for call in recording.call_args_list]
    assert [each.mesh.nelements for each in problems] == [2] * 40
    ends = []
    for problem, met in zip(problems, runs, strict=True):
        pace = 25.0 / problem.duration
        assert PACE[0] <= pace <= PACE[1]
        F, F_dot = (np.array([state[part] for state in met]) for part in (0, 1))
        assert F.shape[1:] == (2 * 5, 2, 2)
        sideways = F - np.eye(2)
        sideways[..., 0, 0] = 0.0
        # Explicit steps are as long as stability lets them be: rounding grows to the tolerance.
        assert abs(sideways).max() < 1e-6
        ends.append(F[-1, :, 0, 0].mean() - 1.0)
        assert abs(F_dot).max() > 0.5 * ends[-1] / (20.0 / pace)
    low, high = (0.02 * factor for factor in FACTOR)
    assert low <= min(ends) < 1.5 * low
    assert 0.8 * high < max(ends) <= high


@pytest.mark.parametrize(
    "amplitude",
    [Ramp(begin=1.0, end=5.0, smooth=True), Sine(frequency=0.1), Pulse(length=6.0)],
)
def test_a_varied_amplitude_is_the_amplitude_scaled_in_size_and_time(amplitude):
    varied, h = Varied(amplitude, 0.7, 1.6), 1e-5
    assert varied.corners() == tuple(t / 1.6 for t in amplitude.corners())
    assert varied.resolved_by == amplitude.resolved_by / 1.6
    for t in (0.9, 2.3):
        value, rate, bend = varied.at(t, t)
        assert value == 0.7 * amplitude.at(1.6 * t, 1.6 * t)[0]
        ahead, behind = varied.at(t + h, t), varied.at(t - h, t)
        assert rate == pytest.approx((ahead[0] - behind[0]) / (2.0 * h), rel=1e-6)
        assert bend == pytest.approx((ahead[1] - behind[1]) / (2.0 * h), rel=1e-6)


def test_falls_and_free_bodies_vary_by_their_factor(written):
    more = """
[conditions.fall]
kind = "initial_velocity"
velocity = [0.0, -2.0]
[bodies.ball]
circle = { radius = 10.0 }
on = "top"
position = [50.0, 71.0]
mass = 3.0
velocity = [0.0, -1.0]
"""
    problem = load_recipe(written(LEARNING + BLOCK + more)).problem()
    found = list(varied_problems(problem, 50, seed=1))
    falls = np.array([problem.conditions[-1].velocity for problem in found])
    balls = np.array([problem.bodies[0].velocity for problem in found])
    for velocity, most in ((falls, 2.0), (balls, 1.0)):
        assert not velocity[:, 0].any()
        assert -FACTOR[1] * most <= velocity[:, 1].min() < -1.3 * most
        assert -0.45 * most < velocity[:, 1].max() <= -FACTOR[0] * most
    assert abs(np.corrcoef(falls[:, 1], balls[:, 1])[0, 1]) < 0.4
    assert found[0].bodies[0].mass == 3.0


def test_a_cell_sees_its_own_points_among_the_others(written, monkeypatch):
    """The stiff middle leaves more of the stretch to the soft end."""
    text = changed(LEARNING, 'file = "cells.h5"', "", 'file = "cells-surrogate.h5"', "")
    recipe = load_recipe(written(text + BLOCK + CELLS))

    def soft(part):
        return SoftCell().of(part.cell.parameters, part.recipe.rve)

    monkeypatch.setattr(train_workflow.laws, "quadratic_law", soft)
    monkeypatch.setattr(train_workflow, "simulate", recording := Mock(wraps=simulate))
    parts = recipe.studies()
    met = {}
    for name, part in parts.items():
        (states,) = train_workflow._runs(part, soft(part), 1, seed=4)
        met[name] = states[-1][0]
    # Coarser elements would make the end thicker, so the mesh stays.
    assert [call.args[0].mesh.nelements for call in recording.call_args_list] == [6, 6]
    assert [len(F) for F in met.values()] == [5, 20]  # of 25
    stretch = {name: F[:, 0, 0].mean() - 1.0 for name, F in met.items()}
    assert stretch["end"] > 1.5 * stretch["middle"] > 0.0
