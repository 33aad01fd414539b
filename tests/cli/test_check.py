"""What `check` tells of a recipe: faults, time, law, and the sampling range that it proposes."""

import itertools
import math
import re
import sys
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange
from surrofe2.macro import MetRange, simulate
from surrofe2.macro.settings import RestSettings
from surrofe2.recipe.recipe import load_recipe
from surrofe2.rve import RveLaw
from surrofe2.workflow import check, scale
from surrofe2.workflow.laws import law_by_region, quadratic_law
from surrofe2.workflow.run import run_study
from surrofe2.workflow.scale import (
    all_particles,
    particles_sentence,
    sap_notes,
    sap_wave_speed,
    scale_warnings,
)
from surrofe2.workflow.tissue import tissue_of
from tests.cli.conftest import call
from tests.conftest import BAR, CELLS, RANGE, RECIPE, ROOT, changed
from tests.laws import SquareLaw
from tests.processes import python

WHOLE = 600.0
"""Seconds in which any of these dry runs comes to its end."""


def test_all_that_is_wrong_is_told_in_one_go(invoke, changed_recipe):
    path = changed_recipe(
        "count = 40", "count = 0", "shear = 0.05\n", "", "[macro]", "[makro]",
        "iterations = 40", "iteration = 40", "duration = 4.0", "duration = '4 µs'",
    )  # fmt: skip
    told = invoke("check", path, code=1).stderr.splitlines()
    starts = {line.partition(": ")[2].partition(": ")[0] for line in told[:-1]}
    wrong = {"samples.count", "range.shear", "makro", "training.iteration", "load.duration"}
    assert starts == wrong
    assert told[-1] == f"error: {path}: 5 problems found"


STATED = """
[cells.skin]
samples = { file = "a.h5" }
training = { file = "a-surrogate.h5" }
[cells.flesh]
samples = { file = "a.h5" }
training = { file = "b-surrogate.h5" }
[mesh]
width = 100.0
height = -1.0
elements = [2, 2]
regions = { skin = { box = [0.0, 0.0] } }
[conditions]
clamp = { kind = "fixd", on = "left" }
pull = { kind = "traction", on = "right" }
[watch]
tip = [100.0]
"""


def test_faults_of_a_stated_problem(written):
    faults = check.recipe_faults(written(STATED))
    told = [sentence.partition(": ")[2].partition(": ")[0] for sentence in faults]
    wrong = {"mesh.height", "mesh.regions.skin.box", "conditions.clamp.kind", "watch.tip"}
    wrong |= {"conditions.pull.traction", "cells.flesh.samples.file"}
    assert set(told) == wrong
    assert len(told) == len(wrong)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[cell", "not TOML"),
        (RECIPE + "[surface]\non = ['nowhere']\n", "surface.on"),
        (RECIPE.replace('file = "cells.h5"', ""), "samples.file: missing"),
    ],
)
def test_files_and_names(invoke, written, text, said):
    is_fault = "samples" not in said  # a run by RVEs needs no samples
    done = invoke("check", written(text), "--only", code=int(is_fault))
    assert said in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("condition", "fault"),
    [
        ('kind = "point_force"\non = { point = [0.0, 0.0] }\nforce = [0.0, 1.0]',
         "again.on: at 0 0; supports hold or move all of it, so the load does nothing"),
        ('kind = "traction"\non = "left"\ntraction = [1.0, 0.0]',
         "again.on: left; supports hold or move all of it, so the load does nothing"),
        ('kind = "prescribed_motion"\non = { point = [0.0, 0.0] }\ndisplacement = [1.0, 0.0]',
         "again: component x of the node at (0, 0) µm; clamp prescribes it otherwise"),
    ],
)  # fmt: skip
def test_loads_and_motions_of_what_is_fixed_are_faults(invoke, written, condition, fault):
    path = written(f"{BAR}[conditions.again]\n{condition}\n")
    done = invoke("check", path, "--only", code=1)
    assert fault in done.stdout + done.stderr


@pytest.mark.usefixtures("data_set")
def test_another_recipe_s_data_set_is_told(invoke, changed_recipe):
    refused = invoke("check", changed_recipe("seed = 3", "seed = 4"), "--only", law=SquareLaw)
    assert "samples.seed: this call has" in refused.stdout


@pytest.fixture
def soft_law(stand_in):
    stand_in(SquareLaw)


def test_check_says_how_long_rves_take_and_writes_nothing(invoke, recipe_path, tmp_path):
    done = invoke("check", recipe_path, "--seconds", WHOLE, law=SquareLaw())
    said = re.search(r"^20 points, about ([\d,]+) evaluations of the stress: ", done.stdout, re.M)
    run = check.dry_run(load_recipe(recipe_path), WHOLE)
    assert float(said[1].replace(",", "")) == pytest.approx(run.calls, rel=0.05)
    assert "recipe.toml: use --law rve" in done.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["recipe.toml"]


@pytest.mark.usefixtures("soft_law")
def test_a_dry_run_asks_as_often_as_the_run(recipe_path, tmp_path):
    recipe = load_recipe(recipe_path, {"load.duration": 40.0})
    found = check.dry_run(recipe, WHOLE)
    counts = run_study(recipe, "rve", tmp_path / "rve").counts
    assert found.reached == 1.0
    calls = (counts["stress_points"] + counts["dissipation_points"]) / found.points
    assert found.calls == pytest.approx(calls, rel=0.05)


@pytest.mark.usefixtures("soft_law")
def test_a_dry_run_that_is_cut_short_is_extrapolated(recipe_path, monkeypatch):
    changes = {"load.duration": 40.0, "macro.elements": [8, 8]}
    recipe = load_recipe(recipe_path, changes)
    ticks = itertools.count()
    monkeypatch.setattr(check, "cpu_clock", lambda: float(next(ticks)))
    whole = check.dry_run(recipe, math.inf)
    steps = next(ticks)  # the clock ticks once a step
    ticks = itertools.count()
    short = check.dry_run(recipe, 1.4 * steps)
    assert short.points == whole.points == 320
    assert short.reached == 1.0  # of 4 × 4 elements, whose steps are longer
    assert len(short.steps[None][0][0]) == 80
    assert short.calls == pytest.approx(whole.calls, rel=0.1)
    assert not short.omitted
    monkeypatch.setattr(check, "MOST_ELEMENTS", 16)
    coarse = check.dry_run(recipe, math.inf)
    assert len(coarse.steps[None][0][0]) == 80
    assert coarse.points == 320
    assert coarse.calls == pytest.approx(whole.calls, rel=0.5)
    ticks = itertools.count()
    shorter = check.dry_run(recipe, 0.1 * steps)
    assert shorter.reached < 1.0
    assert "what is met after" in shorter.omitted


class SlowLaw(SquareLaw):
    """A law of which each point takes a millisecond of its own clock, and a cold one a hundred."""

    SECONDS, time = 1e-3, 0.0

    def respond(self, F, F_dot, state=None, *, tangents=False):
        self.time += (100.0 if state is None else 1.0) * self.SECONDS * len(F)
        return super().respond(F, F_dot, state, tangents=tangents)


def test_the_time_by_rves_is_solves_times_a_solve(recipe_path, monkeypatch, stand_in):
    recipe, law = load_recipe(recipe_path, {"load.duration": 20.0}), SlowLaw()
    stand_in(law)
    run = check.dry_run(recipe, math.inf)
    monkeypatch.setattr(check, "clock", lambda: law.time)
    assert check.seconds_by_rves(recipe, run) == pytest.approx(run.solves * law.SECONDS)


def test_the_advice(recipe, changed_recipe, request):
    assert check.advised_law(recipe, 10.0) == "rve"  # done before a surrogate is trained
    assert check.advised_law(recipe, 1000.0) == "cached"
    assert check.advised_law(recipe, 1000.0, at_rest=True) == "table"  # without training
    request.getfixturevalue("trained")
    assert check.advised_law(recipe, 10.0) == "cached"  # it is there
    without = load_recipe(changed_recipe('file = "cells-surrogate.h5"\n', ""))
    assert check.advised_law(without, 1000.0) == "table"
    implicit = changed_recipe("[macro]", '[macro]\nintegrator = "implicit"')
    assert check.advised_law(load_recipe(implicit), 1000.0) == "table"
    assert check.advised_law(load_recipe(changed_recipe(RANGE, "")), 1000.0) == "rve"


def test_a_recipe_without_a_range_is_for_rves(invoke, changed_recipe):
    done = invoke("check", changed_recipe(RANGE, ""), "--only")
    assert "No [range]: only `--law rve` can run this recipe.\n" in done.stdout


@pytest.mark.parametrize(
    ("changes", "warning"),
    [
        (("[2, 2]", "[4, 4]"), ""),
        (("[2, 2]", "[8, 4]"), "an element is 12.5 µm wide, a plant cell 25 µm"),
        (
            ('preset = "printed"', 'preset = "printed"\narrangement = "voronoi"\ncells = 9'),
            "an RVE is 75 µm wide, an element 50 µm",
        ),
        (
            (
                'preset = "printed"',
                'preset = "printed"\narrangement = "voronoi"\ncells = 4\nelongation = 2.0',
            ),
            "an RVE is 74.",  # a box of 50 µm, stretched
        ),
    ],
)
def test_elements_smaller_than_a_plant_cell_or_an_rve_are_warned_of(
    changed_recipe, changes, warning
):
    warnings = [*scale_warnings(load_recipe(changed_recipe(*changes)))]
    assert [each.startswith(warning) for each in warnings] == [True] * bool(warning)


def test_the_warning_is_of_the_kind_of_cell_whose_elements_are_too_small(written):
    path = written(changed(CELLS, "elements = [2, 2]", "elements = [5, 2]"))
    text = path.read_text(encoding="utf-8")
    assert len([*scale_warnings(load_recipe(path))]) == 2
    path.write_text(
        text.replace("[cells.skin]", "[cells.skin]\ncell_side = 10.0"), encoding="utf-8"
    )
    (warning,) = scale_warnings(load_recipe(path))
    assert warning.startswith("an element of flesh is 20 µm wide, a plant cell 25 µm")


UNDRAINED = 'preset = "apple"\nsap_bulk_modulus = 2200.0'


def test_explicit_runs_with_undrained_sap_name_their_step_and_why(changed_recipe):
    """Water in `apple`: √(2200 MPa / 860 kg/m³) = 1,599 m/s, through an element of 50 µm."""
    recipe = load_recipe(changed_recipe('preset = "printed"', UNDRAINED))
    assert sap_wave_speed(recipe.study().cell.parameters) == pytest.approx(1599.0, rel=1e-3)
    ((before, is_warning),) = sap_notes(recipe)
    ((after, _),) = sap_notes(recipe, 0.01234)
    assert not is_warning
    assert before.startswith("explicit: steps are short, since waves in undrained sap (sap_bulk")
    assert "run at 1599 µm/µs and cross 50 µm, the smallest element, in 0.0313 µs; " in before
    assert after.startswith("explicit: steps of 0.0123 µs on average, since waves in undrained")


def test_drained_sap_implicit_steps_and_sph_fluid_need_no_such_note(changed_recipe, recipe):
    assert not [*sap_notes(recipe)]
    drained = UNDRAINED.replace("2200.0", "0.0")
    assert not [*sap_notes(load_recipe(changed_recipe('preset = "printed"', drained)))]
    undrained = load_recipe(changed_recipe("sap_bulk_modulus = 0.0", "sap_bulk_modulus = 2200.0"))
    implicit = replace(undrained, macro=replace(undrained.macro, integrator="implicit"))
    assert not [*sap_notes(implicit)]
    assert not [*sap_notes(replace(undrained, rest=RestSettings()))]


def test_all_particles_are_those_of_the_tissue(recipe, changed_recipe):
    """But for the outer walls, of which a tissue has more than its cells share."""
    found = all_particles(recipe)
    tissue = tissue_of(recipe).conditions().tissue
    assert found.plant_cells == 16.0
    assert found.particles < tissue.particles < 1.3 * found.particles
    assert found.steps == pytest.approx(4.0 / 0.002)
    stated = load_recipe(changed_recipe("[macro]", "[tissue]\nmicro_step = 1e-4\n[macro]"))
    assert all_particles(stated).steps == pytest.approx(4e4)
    assert found.is_possible
    other = all_particles(load_recipe(changed_recipe("= 100.0\nbody", "= 90.0\nbody")))
    assert not other.is_possible
    assert "does not take this problem: recipe.toml: load" in particles_sentence(other)


@pytest.mark.parametrize(("rate", "advice"), [(1e30, "surrofe2 tissue"), (1e-30, "--law rve")])
def test_all_particles_are_advised_where_they_take_less(
    invoke, recipe_path, monkeypatch, rate, advice
):
    monkeypatch.setattr(scale, "PARTICLE_STEPS", rate)
    done = invoke("check", recipe_path, "--seconds", WHOLE, law=SquareLaw())
    assert "All particles: 16 plant cells, " in done.stdout
    assert advice in done.stdout.splitlines()[-1]


WATCH = """import os, subprocess, sys
process = subprocess.Popen(sys.argv[1:])
_, code, used = os.wait4(process.pid, 0)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)
sys.exit(os.waitstatus_to_exitcode(code))
"""
"""By a process between: a child's peak of memory begins with what its parent has."""


def checked(path, *options):
    """The command in a process: (what it prints, processor seconds, memory in MB)."""
    command = sys.executable, "-m", "surrofe2", "check", path, *options
    printed = python("-c", WATCH, *command).stdout
    seconds, memory = map(float, printed.splitlines()[-1].split())
    return printed, seconds, memory


@pytest.mark.slow
@pytest.mark.parametrize(("elements", "is_large"), [(64, False), (1024, True)])
def test_a_check_ends_soon_and_takes_little_memory(changed_recipe, elements, is_large):
    path = changed_recipe("= 4.0", "= 2000.0", "[2, 2]", f"[{elements}, {elements}]")
    checked(path, "--seconds", "0.1")  # compiles kernels
    printed, seconds, memory = checked(path)
    assert seconds < 20.0
    assert memory < 1000.0
    assert ("the mesh is large" in printed) == is_large
    # elements below a plant cell: all particles take less than FE²
    assert "surrofe2 tissue" in printed


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
    met = simulate(
        recipe.problem(), RveLaw(recipe.study().cell.parameters, recipe.rve), recipe.macro
    ).met
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
    rates = np.array([-rate, rate])[:, None, None] + 0.0 * U
    return MetRange(F=U, F_dot=0.0 * U, U=U, RT_F_dot=rates)


def test_bounds_are_rounded_outward_to_two_digits_of_strain():
    found = check.proposed_range(met((0.9876, 1.0), 0.0331, 0.001234), margin=0.0)
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
        check.proposed_range(met(*given), margin)


def test_each_cell_gets_the_range_that_its_own_points_meet(written):
    """A stiff layer beside a soft one in series: each strained by its share."""
    path = written(SERIES)
    printed = printed_for(path)[0]["cells"]
    assert list(printed) == ["stiff", "soft"]
    recipe = load_recipe(path)
    met = check.dry_run(recipe, 600.0).met
    for name, found in met.items():
        assert SamplingRange(**printed[name]["range"]) == check.proposed_range(found)
    problem = recipe.problem()
    law = law_by_region(recipe, problem.mesh, quadratic_law)
    whole = simulate(problem, law, recipe.macro).met
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
regions = { near = { box = [0.0, 0.0, 50.0, 50.0] } }
[conditions]
clamp = { kind = "fixed", on = "left" }
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


PARTS = """
[mesh]
width = 200.0
height = 100.0
elements = [4, 2]
[mesh.boundaries]
corner = { circle = { centre = [200.0, 100.0], radius = 50.0 } }
[mesh.regions]
skin = { box = [0.0, 50.0, 200.0, 100.0] }
[conditions]
base = { kind = "fixed", on = "left" }
weight = { kind = "body_force", acceleration = [0.0, -0.01] }
nail = { kind = "fixed", on = { point = [200.0, 0.0] } }
[time]
duration = 1.0
"""


def test_a_check_says_what_each_part_of_the_mesh_holds(invoke, written):
    done = invoke("check", written(PARTS), "--only")
    assert done.stdout.splitlines()[:8] == [
        "mesh: 8 quadrilaterals, 15 nodes, x from 0 to 200 µm, y from 0 to 100 µm, 20,000 µm²",
        "boundary left: 2 sides, 3 nodes, 100 µm",
        "boundary right: 2 sides, 3 nodes, 100 µm",
        "boundary bottom: 4 sides, 5 nodes, 200 µm",
        "boundary top: 4 sides, 5 nodes, 200 µm",
        "boundary corner: 2 sides, 3 nodes, 100 µm",
        "region skin: 4 elements, 10 nodes, 10,000 µm²",
        "node at (200, 0) µm: nail",
    ]
