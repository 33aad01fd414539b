"""The sampling range that `surrofe2 check` proposes from a dry run."""

import re
import tomllib

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange
from surrofe2.macro import MetRange, simulate
from surrofe2.recipe.recipe import load_recipe
from surrofe2.rve import RveLaw
from surrofe2.workflow.check import dry_run, proposed_range
from surrofe2.workflow.laws import law_by_region, quadratic_law
from tests.cli.conftest import call
from tests.conftest import ROOT


def printed_for(path):
    """The sections that `check` prints, and all that it prints."""
    said = call("check", path, "--seconds", 600).stdout
    start = re.search(r"^\[(cells\..*\.)?range\]$", said, re.MULTILINE).start()
    return tomllib.loads(said[start : said.index(" points, about")].rpartition("\n")[0]), said


@pytest.fixture
def bending_bar(written):
    """The paper's bar up to past its first minimum, without a range."""
    text = (ROOT / "data/bending-bar.toml").read_text(encoding="utf-8")
    head, rest = text.replace("duration = 250.0", "duration = 40.0").split("[range]")
    return written(head + rest[rest.index("[samples]") :])


def test_a_true_run_stays_within_the_range_proposed(bending_bar):
    sections, printed = printed_for(bending_bar)
    range = SamplingRange(**sections["range"])
    assert "by the quadratic law of the RVE at rest" in printed
    assert "margin 20 %" in printed
    recipe = load_recipe(bending_bar)
    met = simulate(recipe.problem(), RveLaw(recipe.cell, recipe.rve), recipe.macro).met
    assert range.stretch[0] < met.stretch[0] < met.stretch[1] < range.stretch[1]
    assert met.shear < range.shear
    assert met.rate < range.rate
    # and is no waste: of what the run met, each at most twice
    assert 1.0 - range.stretch[0] < 2.0 * (1.0 - met.stretch[0])
    assert range.stretch[1] - 1.0 < 2.0 * (met.stretch[1] - 1.0)
    assert range.shear < 2.0 * met.shear
    assert range.rate < 2.0 * met.rate


def met(stretch, shear, rate):
    U = np.array([np.diag([stretch[0]] * 2), np.diag([stretch[1]] * 2)])
    U[0, 0, 1], U[1, 0, 1] = -shear, 0.5 * shear
    return MetRange(
        F=U, F_dot=0.0 * U, U=U, RT_F_dot=np.array([-rate, rate])[:, None, None] + 0 * U
    )


def test_bounds_are_rounded_outward_to_two_digits_of_strain():
    found = proposed_range(met((0.9876, 1.0), 0.0331, 0.001234), margin=0.0)
    assert (found.stretch, found.shear, found.rate) == ((0.987, 1.0), 0.034, 0.0013)


@pytest.mark.parametrize(
    ("given", "margin", "sentence"),
    [
        (((0.9, 1.1), 0.1, 0.01), -0.1, "--margin: -0.1; it must be a number of at least 0"),
        (((0.9, 1.1), 0.1, 0.01), float("nan"), "--margin: nan"),
        (((1.0, 1.0), 0.0, 0.0), 0.2, "the run met no strain"),
        (((0.4, 1.1), 0.3, 0.01), 0.2, "met stretches down to 0.4 and shear up to 0.3"),
    ],
)
def test_what_gives_no_range_says_why(given, margin, sentence):
    with pytest.raises(InputError, match=sentence):
        proposed_range(met(*given), margin)


def test_each_cell_gets_the_range_that_its_own_points_meet(written):
    """A stiff layer beside a soft one in series: each strained by its share."""
    path = written(SERIES)
    printed = printed_for(path)[0]["cells"]
    assert list(printed) == ["stiff", "soft"]
    recipe = load_recipe(path)
    met = dry_run(recipe, 600.0).met
    for name, found in met.items():
        assert SamplingRange(**printed[name]["range"]) == proposed_range(found)
    whole = simulate(
        recipe.problem(),
        law_by_region(recipe, recipe.problem().mesh, quadratic_law),
        recipe.macro,
    ).met
    assert max(each.stretch[1] for each in met.values()) == whole.stretch[1]
    assert min(each.rate for each in met.values()) < max(each.rate for each in met.values())
    assert max(each.rate for each in met.values()) == whole.rate
    strain = {name: each.stretch[1] - 1.0 for name, each in met.items()}
    assert strain["soft"] > 1.3 * strain["stiff"]


SERIES = """
[mesh]
width = 100.0
height = 50.0
elements = [2, 1]
[mesh.regions.near]
box = [0.0, 0.0, 50.0, 50.0]
[conditions.clamp]
kind = "fixed"
on = "left"
[conditions.grip]
kind = "prescribed_motion"
on = "right"
displacement = [1.0, 0.0]
amplitude = { kind = "ramp", end = 60.0, smooth = true }
[time]
duration = 60.0
[cells.stiff]
wall_stiffness = 12000.0
regions = ["near"]
[cells.soft]
regions = ["rest"]
"""
