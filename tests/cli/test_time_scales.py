"""Whether a problem is slow or fast, and what `check` then tries and advises."""

import numpy as np
import pytest

from surrofe2.macro import find_modes, find_rest
from surrofe2.problem import Fixed, Problem, Traction, rectangle
from surrofe2.problem.amplitude import Constant, Pulse, Ramp, Sine, Table
from surrofe2.recipe.recipe import load_recipe
from surrofe2.workflow import check
from surrofe2.workflow.laws import law_by_region, quadratic_law
from surrofe2.workflow.time_scales import held_since, viscous_time
from tests.laws import KelvinVoigt, SquareLaw

PULLED = """
[cell]
preset = "printed"
[range]
stretch = [0.95, 1.05]
shear = 0.05
rate = 0.01
[mesh]
width = 100.0
height = 50.0
elements = [4, 2]
[conditions]
foot = { kind = "fixed", on = "left" }
grip = { kind = "prescribed_motion", on = "right", displacement = [4.0, 0.0], AMPLITUDE }
[time]
duration = DURATION
"""


def pulled(written, duration, amplitude="amplitude = {{ kind = 'ramp', end = {} }}"):
    text = PULLED.replace("AMPLITUDE", amplitude.format(duration))
    return written(text.replace("DURATION", str(duration)))


def test_scales_are_those_of_waves_and_modes(stand_in, written):
    stand_in(SquareLaw)
    recipe = load_recipe(pulled(written, 1000.0))
    scales = check.scales_of(recipe)
    problem = recipe.problem()
    law = law_by_region(recipe, problem.mesh, quadratic_law)
    modes = find_modes(find_rest(problem, law, factor=0.0), 1)
    assert scales.swing == pytest.approx(max(modes.periods[0], 4.0 * scales.wave))
    strain = np.array([[[1.0 + 1e-6, 0.0], [0.0, 1.0]]])
    modulus = law.respond(strain, np.zeros((1, 2, 2))).stress[0, 0, 0] / 1e-6
    speed = np.sqrt(modulus / law.density)
    assert scales.wave == pytest.approx(100.0 / speed, rel=1e-3)
    assert scales.cell == pytest.approx(25.0 / speed, rel=1e-3)


PLATES = """
[bodies.floor]
plane = { normal = [0.0, 1.0] }
on = "bottom"
position = [0.0, 0.0]
friction = FRICTION
[bodies.plate]
plane = { normal = [0.0, -1.0] }
on = "top"
position = [0.0, 50.0]
displacement = [0.0, -1.0]
amplitude = { kind = "ramp", end = DURATION }
friction = FRICTION
"""


@pytest.mark.parametrize("elements", ["4, 2", "24, 12"])
@pytest.mark.parametrize(("friction", "is_held"), [("0.3", True), ("0.0", False)])
def test_a_tissue_between_plates(stand_in, written, elements, friction, is_held):
    """Until they press it moves freely; by friction they hold it, and slow plates find it at
    rest. Dense and sparse eigenvalues of such a motion are rounding alone."""
    stand_in(SquareLaw)
    text = PULLED.replace("4, 2", elements).partition("[conditions]")[0] + PLATES
    text = text.replace("FRICTION", friction) + "[time]\nduration = DURATION\n"
    scales = check.scales_of(load_recipe(written(text.replace("DURATION", "1e5"))))
    assert scales.swing == (4.0 * scales.wave if is_held else np.inf)
    assert scales.is_slow == is_held
    assert ("which nothing holds; the fastest load takes" in scales.sentence) != is_held


@pytest.mark.parametrize(("duration", "is_slow"), [(10.0, False), (1e5, True)])
def test_a_ramp_is_slow_or_fast(stand_in, written, duration, is_slow):
    stand_in(SquareLaw)
    scales = check.scales_of(load_recipe(pulled(written, duration)))
    assert 0.2 * duration < scales.load <= duration
    assert scales.is_slow == is_slow
    assert ("quasi-static: use rest" in scales.sentence) == is_slow
    assert ("dynamic" in scales.sentence) != is_slow


def test_a_sudden_load_is_never_slow(stand_in, recipe):
    """The paper's bar: its body force is there from the start."""
    stand_in(SquareLaw)
    scales = check.scales_of(recipe)
    assert scales.load == 0.0
    assert "the loads are sudden: dynamic" in scales.sentence


def test_a_recipe_of_a_rest_is_not_said_to_be_dynamic(stand_in, written):
    """Its motion has no amplitude, and would be sudden in time."""
    stand_in(SquareLaw)
    path = pulled(written, 10.0)
    text = path.read_text(encoding="utf-8").partition("[time]")[0] + "[rest]\nload_steps = 3\n"
    scales = check.scales_of(load_recipe(written(text)))
    assert "the recipe states [rest]: load steps, without time" in scales.sentence
    assert "dynamic" not in scales.sentence


def test_check_tries_a_rest_where_loads_are_slow(invoke, written):
    path = pulled(written, 1e6)
    done = invoke("check", path, law=SquareLaw())
    assert "quasi-static: use rest" in done.stdout
    assert f"quasi-static: use `surrofe2 rest {path} --law " in done.stdout
    assert "The rest would take" in done.stdout
    # of the whole path: 4 % along the pull, with a margin of 20 %
    assert "stretch = [0.9" in done.stdout
    run = check.dry_rest(load_recipe(path))
    assert run.reached == 1.0
    assert run.met[None].stretch[1] == pytest.approx(1.04, abs=0.01)
    assert check.proposed_range(run.met[None]).rate == check.LEAST_RATE
    assert run.displacement == pytest.approx(4.0, abs=0.1)
    stated = path.read_text(encoding="utf-8") + "[rest]\nload_steps = 3\n"
    path.write_text(stated, encoding="utf-8")
    again = invoke("check", path, law=SquareLaw())
    assert again.stdout.splitlines()[-1].startswith(f"{path}: use --law ")


def test_rves_of_a_rest_are_timed_with_their_tangents(stand_in, written):
    """Tangents take as long as the stress, and each solve of a rest has them."""
    asked = []

    class Timed(SquareLaw):
        def respond(self, F, F_dot, state=None, *, tangents=False):
            asked.append(tangents)
            return super().respond(F, F_dot, state, tangents=tangents)

    stand_in(Timed)
    recipe = load_recipe(pulled(written, 10.0))
    for run, expected in ((check.dry_rest(recipe), True), (check.dry_run(recipe), False)):
        asked.clear()
        assert check.seconds_by_rves(recipe, run) > 0.0
        assert {*asked} == {expected}


def test_a_dry_rest_keeps_to_its_time(stand_in, written, monkeypatch):
    """On a coarser mesh, or to a part of the load; a point of the tissue takes a second here."""
    stand_in(SquareLaw)
    now = [0.0]

    class Slow(check._Recorder):
        def respond(self, F, F_dot, state=None, *, tangents=False):
            now[0] += len(F)
            return super().respond(F, F_dot, state, tangents=tangents)

    monkeypatch.setattr(check, "_Recorder", Slow)
    monkeypatch.setattr(check, "cpu_clock", lambda: now[0])
    path = pulled(written, 1e6)
    path = written(path.read_text(encoding="utf-8").replace("[4, 2]", "[16, 8]"))
    recipe = load_recipe(path)
    whole = check.dry_rest(recipe, np.inf)
    assert (whole.reached, whole.omitted) == (1.0, "")
    assert now[0] == pytest.approx(whole.solves)
    shorter = check.dry_rest(recipe, whole.solves)
    assert (shorter.reached, shorter.points, shorter.omitted) == (1.0, whole.points, "")
    assert shorter.calls == pytest.approx(whole.calls, rel=0.2)
    assert shorter.met[None].stretch[1] == pytest.approx(1.04, abs=0.01)
    part = check.dry_rest(recipe, 0.1 * whole.solves)
    assert 0.0 < part.reached < 1.0
    assert part.omitted == f"what is met after {100.0 * part.reached:.3g} % of the load"
    assert part.calls == pytest.approx(whole.calls, rel=0.4)


def test_check_finds_a_body_that_begins_inside_the_tissue(invoke, written):
    text = pulled(written, 10.0).read_text(encoding="utf-8")
    floor = (
        "[bodies.floor]\nplane = { normal = [0.0, 1.0] }\non = 'bottom'\nposition = [0.0, HERE]\n"
    )
    for height, code in (("0.0", 0), ("5.0", 1)):
        path = written(text + floor.replace("HERE", height))
        done = invoke("check", path, "--only", law=SquareLaw(), code=code)
        told = "bodies.floor.position: [0.0, 5.0]; the tissue begins 5 µm inside it"
        assert (told in done.stderr + done.stdout) == (code == 1)
    refused = invoke("rest", path, "--out", path.with_name("rest"), law=SquareLaw(), code=1)
    assert told in refused.stderr
    assert not path.with_name("rest").exists()


def test_a_range_of_a_part_says_so_in_its_first_line(invoke, written):
    path = pulled(written, 400.0, "amplitude = 1.0").read_text(encoding="utf-8")
    path = path.replace('kind = "prescribed_motion"', 'kind = "traction"')
    path = path.replace("displacement = [4.0, 0.0]", "traction = [0.05, 0.0]")
    done = invoke("check", written(path), "--seconds", "0.01", law=SquareLaw())
    lines = done.stdout.splitlines()
    first = next(k for k, line in enumerate(lines) if line == "[range]")
    assert lines[first - 1].startswith("# this range holds only a part of the run; left out: ")


@pytest.mark.parametrize(
    ("viscosities", "slowest"),
    [
        ({"shear_viscosity": 6.0, "bulk_viscosity": 0.0}, 6.0 / 60.0),  # η/µ, ζ/(λ + µ)
        ({"shear_viscosity": 0.0, "bulk_viscosity": 7.0}, 7.0 / 140.0),
    ],
)
def test_the_slowest_viscous_time_of_a_kelvin_voigt_law(viscosities, slowest):
    assert viscous_time(KelvinVoigt(**viscosities)) == pytest.approx(slowest, rel=1e-9)


SMALL = "25.0\nelements = [2, 1]"
HELD = Ramp(end=2.0, smooth=True)


@pytest.mark.parametrize(
    ("amplitude", "since"),
    [
        (HELD, 2.0),
        (Constant(value=0.5), 0.0),
        (Pulse(begin=1.0, length=3.0), 4.0),
        (Sine(frequency=0.1), 10.0),
        (Ramp(begin=8.0, end=12.0), 10.0),
        (Table(points=((0.0, 0.0), (1.0, 1.0), (5.0, 1.0), (6.0, 0.0))), 6.0),
    ],
)
def test_loads_stand_still_from_their_last_change_on(amplitude, since):
    mesh = rectangle(10.0, 10.0, (1, 1))
    others = Fixed(on="left"), Traction(on="top", traction=(0.1, 0.0), amplitude=HELD)
    load = Traction(name="load", on="right", traction=(1.0, 0.0), amplitude=amplitude)
    problem = Problem(mesh=mesh, conditions=(*others, load), duration=10.0)
    assert held_since(problem) == max(since, 2.0)


def test_a_run_that_is_over_long_after_its_viscous_time_says_so(invoke, written, tmp_path):
    """One plant cell rings for some microseconds alone."""

    def output(method, duration, *command):
        path = pulled(written, duration, "amplitude = {{ kind = 'ramp', end = 2.0 }}")
        text = path.read_text().replace("100.0", "25.0").replace("50.0\nelements = [4, 2]", SMALL)
        path.write_text(text)
        out = tmp_path / f"{method} {duration}"
        return invoke(*command, path, "--out", out, law=SquareLaw).stdout

    for method, command in (("run", ("run", "--law", "rve")), ("rest", ("rest",))):
        long = output(method, 200.0, *command)
        assert "nothing relaxes further in this model: its slowest viscous time is " in long
        assert "loads stand still from 2 to 200 µs" in long
        assert "nothing relaxes" not in output(method, 2.5, *command)
