"""A run that was interrupted or killed and resumes is the uninterrupted one, to the bit."""

from contextlib import suppress
from shutil import copytree

import meshio
import numba
import numpy as np
import pytest

from surrofe2.recipe.recipe import load_recipe
from surrofe2.rve import RveLaw
from surrofe2.store.fields import open_fields
from surrofe2.store.hdf5 import read
from surrofe2.store.run_folder import CHECKPOINT, STATE, caches_of, read_record
from surrofe2.workflow import rest, run, tissue
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.rest import rest_study
from surrofe2.workflow.run import run_study
from surrofe2.workflow.tissue import run_tissue
from surrofe2.workflow.train import train_surrogate
from tests import conftest
from tests.commands import SMALL, STRONG
from tests.conftest import RECIPE, changed
from tests.folders import assert_same

CACHED = STRONG + "[cache]\ntolerance = 0.2\naudit = 0.1\n"
TABLE = CACHED + "[table]\ntolerance = 1e-3\n"
CELLS = changed(conftest.CELLS, "-0.1]", "-0.9]")
CELLS += "[table]\ntolerance = 1e-2\n[cache]\naudit = 0.3\n"
IMPLICIT = 'integrator = "implicit"\n'


BALL = """
[cell]
preset = "printed"
[rve]
initialisation = "constrained-runs"
[mesh]
width = 100.0
height = 50.0
elements = [2, 1]
[conditions]
floor = { kind = "fixed", on = "bottom" }
[bodies.ball]
circle = { radius = 60.0 }
on = "top"
position = [40.0, 110.1]
mass = 2000.0
velocity = [0.4, -0.8]
friction = 0.5
[watch]
top = [50.0, 50.0]
[time]
duration = 4.0
output_interval = 0.25
[macro]
"""
"""A rough ball that hits a tissue and drags it along."""
HEXAGONS = changed(BALL, '"printed"', '"printed"\narrangement = "hexagon"\ncells = 1')
IN_CONTACT = {
    "printed": BALL,
    "hexagons": HEXAGONS,
    "slow manifold": changed(BALL, "constrained-runs", "slow-manifold"),
    "hexagons on the slow manifold": changed(HEXAGONS, "constrained-runs", "slow-manifold"),
    "implicit": BALL + IMPLICIT,
    "strong": changed(BALL, "-0.8]", "-4.0]", "duration = 4.0", "duration = 8.0"),
}


def by(initialisation, solver="direct"):
    return STRONG + f'[rve]\ninitialisation = "{initialisation}"\nsolver = "{solver}"\n'


CASES = {
    "rve": ("rve", STRONG),
    "surrogate": ("surrogate", RECIPE),
    "cached": ("cached", CACHED),
    "table": ("table", TABLE),
}
LONG_CASES = {
    "cached on many": ("cached", CACHED.replace("[2, 2]", "[6, 4]")),
    "rve implicit": ("rve", STRONG + IMPLICIT),
    "slow-manifold": ("rve", by("slow-manifold")),
    "elastic": ("rve", by("elastic")),
    "cauchy-born": ("rve", by("cauchy-born")),
    "iterated": ("rve", by("constrained-runs", "iterated").replace("= 4.0", "= 1.0")),
    "cached implicit": ("cached", CACHED.replace("[cache]", IMPLICIT + "[cache]")),
    "cells by rve": ("rve", CELLS),
    "cells by table": ("table", CELLS),
}


class Stop(KeyboardInterrupt):
    pass


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A folder with a surrogate that knows little."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "recipe.toml").write_text(CACHED, encoding="utf-8")
    recipe = load_recipe(folder / "recipe.toml")
    generate_data_set(recipe.study())
    train_surrogate(recipe.study())
    return folder


@pytest.fixture(
    params=[*CASES, *(pytest.param(each, marks=pytest.mark.slow) for each in LONG_CASES)]
)
def case(request, home):
    """(recipe, law, name)."""
    law, text = (CASES | LONG_CASES)[request.param]
    (home / "recipe.toml").write_text(text, encoding="utf-8")
    return load_recipe(home / "recipe.toml"), law, request.param


def after(steps, act):
    """A report that acts when so many steps have been made."""
    left = [steps]

    def report(t, note):
        left[0] -= t > 0.0
        if left[0] == 0:
            left[0] = -1
            act()

    return report


def interrupted(recipe, law, out, steps):
    def stop():
        raise Stop

    with pytest.raises(Stop):
        run_study(recipe, law, out, report=after(steps, stop))
    assert read_record(out).status == "interrupted"


def test_a_resumed_run_is_the_uninterrupted_one(case, tmp_path, monkeypatch):
    recipe, law, name = case
    whole = tmp_path / "whole"
    record = run_study(recipe, law, whole)
    steps = record.counts["steps"]
    assert steps > 8
    if law in ("cached", "table"):
        assert record.counts["hits"] > 0
        assert record.counts["fallbacks"] > 0
        assert any(cache["audit"]["audited"] for cache in caches_of(record.cache).values())
        assert list(whole.glob("harvest*.h5"))
    if "table" in name:
        assert record.counts["table_added"] > 1  # the first is that of the undeformed state

    twice = tmp_path / "twice"
    interrupted(recipe, law, twice, steps // 3)
    interrupted(recipe, law, twice, 2)
    run_study(recipe, law, twice)
    assert_same(twice, whole)

    late = tmp_path / "late"
    interrupted(recipe, law, late, steps - 1)
    run_study(recipe, law, late)
    assert_same(late, whole)

    # Killed in the step after a checkpoint, and again before there was another one.
    here, killed, again = (tmp_path / each for each in ("here", "killed", "again"))
    with monkeypatch.context() as patched:
        patched.setattr(run, "CHECKPOINT_INTERVAL", 0.0)
        run_study(recipe, law, here, report=after(steps // 2, lambda: copytree(here, killed)))
    assert_same(here, whole)
    assert read_record(killed).status == "running"
    assert not list(killed.glob("*harvest*"))
    run_study(recipe, law, killed, report=after(3, lambda: copytree(killed, again)))
    assert_same(killed, whole)
    run_study(recipe, law, again)
    assert_same(again, whole)


def stop_at(patched, call, kind=RveLaw):
    """Let RVEs be interrupted at this call of their law, from now on: `respond` or `accept`."""
    made = []

    def counted(method):
        def act(law, *arguments, **options):
            made.append(method)
            if len(made) == call:
                raise Stop
            return method(law, *arguments, **options)

        return act

    for name in ("respond", "accept"):
        patched.setattr(kind, name, counted(getattr(kind, name)))
    return made


@pytest.mark.parametrize(
    "name", ["printed", *(pytest.param(each, marks=pytest.mark.slow) for each in [*IN_CONTACT][1:])]
)
def test_a_run_in_contact_resumes_to_the_bit_from_anywhere(name, written, tmp_path, monkeypatch):
    """Interrupted at random calls of the RVEs, with a checkpoint after every step."""
    recipe, whole, ended = load_recipe(written(IN_CONTACT[name])), tmp_path / "w", tmp_path / "e"
    random = np.random.default_rng(sum(map(ord, name)))
    with monkeypatch.context() as patched:
        calls = stop_at(patched, 0)
        record = run_study(recipe, "rve", whole)
    assert record.counts["steps"] > 8
    history = np.genfromtxt(whole / "history.csv", delimiter=",", names=True)
    assert abs(history["force_ball_x_uN"]).max() > 1.0
    monkeypatch.setattr(run, "CHECKPOINT_INTERVAL", 0.0)
    for _ in range(5):
        with monkeypatch.context() as patched, suppress(Stop):
            stop_at(patched, int(random.integers(1, len(calls) // 3)))
            run_study(recipe, "rve", ended)
    run_study(recipe, "rve", ended)
    assert_same(ended, whole)


def test_a_run_under_way_can_be_looked_at_and_its_checkpoint_holds_no_fields(
    home, tmp_path, monkeypatch
):
    recipe, seen = load_recipe(home / "recipe.toml"), []

    def look(t, note):
        if (tmp_path / CHECKPOINT).exists() and t < recipe.duration:
            with meshio.xdmf.TimeSeriesReader(tmp_path / "fields.xdmf") as reader:
                reader.read_points_cells()
                seen.append([reader.read_data(k)[0] for k in range(reader.num_steps)])
            _, arrays = read(tmp_path / CHECKPOINT, STATE)
            assert arrays["macro.frames.t"].tolist() == seen[-1] == open_fields(tmp_path).t.tolist()
            of_frames = {name: len(of) for name, of in arrays.items() if "frames." in name}
            assert {name for name, rows in of_frames.items() if rows} == {
                "macro.frames.t", "macro.frames.point_t", "macro.mark.frames.t",
                "macro.mark.frames.point_t",
            }  # fmt: skip

    monkeypatch.setattr(run, "CHECKPOINT_INTERVAL", 0.0)
    run_study(recipe, "cached", tmp_path, report=look)
    assert len(seen) > 5
    assert len(seen[-1]) > len(seen[0])


def test_a_resumed_rest_is_the_uninterrupted_one(written, tmp_path, monkeypatch):
    recipe = load_recipe(written(by("slow-manifold")))

    def stopped(out, factor):
        def stop(done, note):
            if done > factor:
                raise Stop

        with pytest.raises(Stop):
            rest_study(recipe, out, report=stop)
        assert read_record(out).status == "interrupted"
        assert 0.0 < open_fields(out).t[-1] <= 1.0  # what is there can be looked at

    whole, twice, here, killed = (tmp_path / name for name in ("whole", "twice", "here", "killed"))
    rest_study(recipe, whole)
    stopped(twice, 0.25)
    stopped(twice, 0.55)
    rest_study(recipe, twice)
    assert_same(twice, whole)
    stopped(tmp_path / "late", 0.95)
    rest_study(recipe, tmp_path / "late")
    assert_same(tmp_path / "late", whole)

    def copy(done, note):
        if done > 0.65 and not killed.exists():
            copytree(here, killed)

    monkeypatch.setattr(rest, "CHECKPOINT_INTERVAL", 0.0)
    rest_study(recipe, here, report=copy)
    rest_study(recipe, killed)
    assert_same(killed, whole)


def test_a_resumed_tissue_is_the_uninterrupted_one_to_the_bit(written, tmp_path, monkeypatch):
    text = changed(SMALL, "duration = 4.0", "duration = 1.0\noutput_interval = 0.1")
    recipe, (whole, killed) = load_recipe(written(text)), (tmp_path / each for each in "wk")
    monkeypatch.setattr(tissue, "CHECKPOINT_INTERVAL", 0.0)
    run_tissue(recipe, whole, report=after(5, lambda: copytree(whole, killed)))
    assert read_record(killed).status == "running"
    for steps in (1, 2):

        def stop():
            raise Stop

        with pytest.raises(Stop):
            run_tissue(recipe, killed, report=after(steps, stop))
    run_tissue(recipe, killed)
    assert_same(killed, whole)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="needs two threads")
def test_goes_on_with_other_threads_within_rounding(written, tmp_path):
    recipe = load_recipe(written(STRONG))
    whole, other = tmp_path / "whole", tmp_path / "other"
    run_study(recipe, "rve", whole)
    interrupted(recipe, "rve", other, 6)
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1 if before > 1 else 2)
        run_study(recipe, "rve", other)
    finally:
        numba.set_num_threads(before)
    curves = [np.loadtxt(each / "curve.csv", delimiter=",", skiprows=1) for each in (whole, other)]
    amplitude = np.abs(curves[0][:, 1:]).max()
    np.testing.assert_allclose(curves[1], curves[0], rtol=0.0, atol=1e-9 * amplitude)
