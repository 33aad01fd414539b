"""Rows of results at stated times, at equal ratios, or at multiples of an interval."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.macro import MacroSettings, simulate
from surrofe2.problem.mesh import rectangle
from surrofe2.problem.problem import Problem
from surrofe2.recipe.recipe import load_recipe
from tests.laws import KelvinVoigt

STATED = """
[mesh]
width = 60.0
height = 40.0
elements = [2, 1]
[conditions]
foot = { kind = "fixed", on = "left" }
pull = { kind = "traction", on = "right", traction = [0.05, 0.0] }
[time]
duration = 8.0
"""


@pytest.mark.parametrize(
    ("entries", "times"),
    [
        ("output_interval = 4.0", [0.0, 4.0, 8.0]),
        ("output_times = [0.1, 1.0, 3.0]", [0.0, 0.1, 1.0, 3.0, 8.0]),
        ("output_times = [2.0, 8.0]", [0.0, 2.0, 8.0]),
        ("output_interval = 0.08\noutputs_per_decade = 2",
         [0.0, 0.08, 0.08 * 10**0.5, 0.8, 0.8 * 10**0.5, 8.0]),
        ("output_interval = 8.0\noutputs_per_decade = 2", [0.0, 8.0]),
    ],
)  # fmt: skip
def test_a_run_has_rows_at_these_times(written, entries, times):
    recipe = load_recipe(written(STATED + entries))
    np.testing.assert_allclose(recipe.problem().output_times(), times)
    run = simulate(recipe.problem(), KelvinVoigt(), MacroSettings(frames=2))
    np.testing.assert_allclose(run.curve.t, times)
    dense = simulate(
        load_recipe(written(STATED + "output_interval = 0.01")).problem(),
        KelvinVoigt(), MacroSettings(frames=2),
    )  # fmt: skip
    expected = np.interp(times, dense.curve.t, dense.curve.displacement[:, 0])
    np.testing.assert_allclose(run.curve.displacement[:, 0], expected, atol=2e-5)


def test_times_at_equal_ratios_span_any_number_of_decades(written):
    problem = load_recipe(
        written(STATED + "output_interval = 8e-9\noutputs_per_decade = 1")
    ).problem()
    np.testing.assert_allclose(problem.output_times(), [0.0, *(8.0 * 10.0 ** np.arange(-9.0, 1.0))])


def test_stated_times_need_no_interval():
    """That of the class would be too short for a run so long."""
    mesh = rectangle(60.0, 40.0, (2, 1))
    problem = Problem(mesh=mesh, conditions=(), duration=1e7, times=(1.0, 1e7))
    np.testing.assert_array_equal(problem.output_times(), [0.0, 1.0, 1e7])


@pytest.mark.parametrize(
    ("entries", "refusal"),
    [
        ("output_times = [2.0, 1.0]", r"time.output_times: \[2.0, 1.0\]; they must increase"),
        ("output_times = [2.0, 9.0]", "up to at most the duration, 8.0 µs"),
        ("output_times = []", "time.output_times"),
        ("output_times = [1.0]\noutputs_per_decade = 3", "not with output_times; leave one out"),
        ("output_times = [1.0]\noutput_interval = 3.0", "not with output_times; leave one out"),
        ("outputs_per_decade = 10000000000", "10000000000; it must be an integer from 1 to 1000"),
    ],
)
def test_times_that_cannot_be_are_refused(written, entries, refusal):
    with pytest.raises(InputError, match=refusal):
        load_recipe(written(STATED + entries))
