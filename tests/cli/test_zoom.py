"""A look into the cells of short runs by true plant cells: the command, its files and errors."""

import shutil
from dataclasses import replace

import meshio
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image

from surrofe2.base.errors import FileError, InputError
from surrofe2.cli import console
from surrofe2.plant_cell.arrangement import rim_areas
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.recipe.recipe import load_recipe
from surrofe2.report.figures import draw_cells
from surrofe2.rve import RveLaw
from surrofe2.store.fields import CELL, F_DOT_NAME, F_NAME, read_fields, write_rve_fields
from surrofe2.store.run_folder import read_record
from surrofe2.store.store import locked_folder
from surrofe2.workflow.zoom import (
    FIELDS_OF_MOTION,
    cell_numbers,
    extremes_of,
    recipes_of,
    write_zoom,
    zoom_into,
)
from tests.cli.conftest import FIELDS, call
from tests.conftest import CELLS, RECIPE, ROOT


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A recipe and the folder of its run with cell fields."""
    folder = tmp_path_factory.mktemp("zoom")
    recipe = folder / "recipe.toml"
    recipe.write_text(RECIPE + "frames = 5\n", encoding="utf-8")
    call("run", recipe, "--law", "rve", "--cell-fields", "--out", folder / "run")
    return recipe, folder / "run"


@pytest.fixture(scope="module")
def looked(study):
    done = call("zoom", study[1], "--point", "90,70")
    return done, study[1] / "zoom-90-70"


@pytest.fixture(scope="module")
def seen(study):
    recipe, run = study
    motion = read_fields(run, FIELDS_OF_MOTION, (CELL,))
    settings = load_recipe(recipe)
    law = RveLaw(settings.study().cell.parameters, settings.rve)
    return motion, law.particles(*(motion.values[name][:, 3] for name in (F_NAME, F_DOT_NAME)))


def test_the_command_writes_what_it_saw(looked):
    done, out = looked
    names = [*FIELDS, "zoom.csv", "zoom.png"]
    assert sorted(path.name for path in out.iterdir()) == names
    assert f"{out}: element 3 at 5 times" in done.stdout
    with Image.open(out / "zoom.png") as picture:
        assert np.asarray(picture.convert("L")).std() > 10.0


def test_many_points_are_looked_into_at_once(study, looked, tmp_path):
    points = ("--point", "90,70", "--point", "10,20")
    done = call("zoom", study[1], *points, "--format", "svg", "--out", tmp_path)
    for k, name in enumerate(("zoom-90-70", "zoom-10-20")):
        assert f"{tmp_path / name}: element {3 - 3 * k} at 5 times" in done.stdout
        picture = (tmp_path / name / "zoom.svg").read_text(encoding="utf-8")
        assert "fluid pressure (MPa)" in picture
    alone = (looked[1] / "zoom.csv").read_text(encoding="utf-8")
    assert (tmp_path / "zoom-90-70" / "zoom.csv").read_text(encoding="utf-8") == alone
    looks = zoom_into(study[1], [(90.0, 70.0), (10.0, 20.0)])
    assert [each.element for each in looks] == [3, 0]
    assert repr(looks[0]).startswith("<Zoom: point (90, 70) µm, element 3, times 5, wall stretch")
    assert len(repr(looks[0])) < 200
    with pytest.raises(InputError, match=r"point: \[1.0, 2.0, 3.0\]; it must be \(x, y\) in µm"):
        zoom_into(study[1], [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="format: 'gif': unknown format of pictures"):
        write_zoom(looks[0], tmp_path / "none", form="gif")
    assert not (tmp_path / "none").exists()


def test_table_of_extremes(looked, seen):
    motion, particles = seen
    table = np.genfromtxt(looked[1] / "zoom.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(table["t_us"], motion.t)
    for name, values in particles.extremes().items():
        np.testing.assert_allclose(table[name], values, rtol=1e-7)
    assert np.ptp(table["largest_wall_stretch"]) > 1e-4


def test_springs_for_paraview_have_their_length_across_the_boundary_too(looked, seen):
    _, particles = seen
    with meshio.xdmf.TimeSeriesReader(looked[1] / "fields.xdmf") as reader:
        points, (springs,) = reader.read_points_cells()
        for k in range(5):
            _, at_points, of_cells = reader.read_data(k)
            x = points + at_points["displacement_um"]
            own = x[: particles.position.shape[1], :2]
            np.testing.assert_allclose(own, particles.position[k], rtol=0, atol=1e-6)
            ends = x[springs.data]
            length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
            ratio = length / of_cells["wall_stretch"][0]
            np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    assert at_points["image"].sum() > 0


def test_cell_fields_are_the_extremes_of_the_particles(study, seen):
    _, particles = seen
    extremes = particles.extremes()
    stored = read_fields(study[1], extremes)
    for name, values in extremes.items():
        assert stored.values[name].shape == (5, 4)
        np.testing.assert_allclose(stored.values[name][:, 3], values, rtol=1e-7)
    with meshio.xdmf.TimeSeriesReader(study[1] / "fields.xdmf") as reader:
        reader.read_points_cells()
        _, _, in_cells = reader.read_data(4)
    np.testing.assert_array_equal(in_cells[name][0], stored.values[name][4])


def test_cell_fields_of_a_run_that_is_finished(study, tmp_path):
    recipe, with_them = study
    command = ("run", recipe, "--law", "rve", "--out", tmp_path / "run")
    call(*command)
    name = "largest_wall_stretch"
    assert not read_fields(tmp_path / "run", (), [name]).values
    with locked_folder(tmp_path / "run"):
        call(*command, "--cell-fields", code=1)
    done = call(*command, "--cell-fields")
    assert "cell fields of 20 RVEs in " in done.stdout
    here, there = (read_fields(each, [name]).values[name] for each in (tmp_path / "run", with_them))
    np.testing.assert_allclose(here, there, rtol=1e-12)


def test_no_stress_no_extremes():
    law = RveLaw(CellParameters.preset("printed"))
    F = np.stack([np.eye(2), np.diag([3.0, 0.3])])[:, None]
    found = extremes_of(law, F, 0.0 * F)["largest_wall_stretch"]
    assert np.isfinite(found[0, 0])
    assert np.isnan(found[1, 0])


def test_zoom_into_a_rest(study, tmp_path, monkeypatch):
    monkeypatch.setattr(console, "SELDOM", 0.0)
    call("rest", study[0], "--load-steps", 2, "--out", tmp_path / "rest")
    done = call("zoom", tmp_path / "rest", "--point", "10,10", "--out", tmp_path / "look")
    told = [line.split(" %")[0] for line in done.stderr.splitlines()]
    assert told == ["zoom: 0", "zoom: 10", "zoom: 50"]
    table = np.genfromtxt(tmp_path / "look" / "zoom.csv", delimiter=",", names=True)
    np.testing.assert_array_equal(table["factor"], [0.0, 0.5, 1.0])


def test_several_cells_are_looked_into_by_the_cell_of_the_point(written, tmp_path):
    path = written(CELLS.replace("duration = 4.0", "duration = 2.0\nframes = 3"))
    run, rest = tmp_path / "run", tmp_path / "rest"
    done = call("run", path, "--law", "rve", "--cell-fields", "--out", run)
    assert "cell fields of 12 RVEs" in done.stdout, done.output
    call("rest", path, "--load-steps", 1, "--out", rest)
    stored = read_fields(run, [CELL, "largest_wall_stretch"])
    assert stored.values[CELL][2].tolist() == [1.0, 0.0, 1.0, 0.0]
    stretch = stored.values["largest_wall_stretch"][2]
    cells = {name: cell.parameters for name, cell in load_recipe(path).cells.items()}
    for y, name in ((75.0, "skin"), (25.0, "flesh")):
        found = zoom_into(run, (25.0, y))
        assert found.cell == name
        motion = read_fields(run, FIELDS_OF_MOTION, (CELL,))
        law = RveLaw(cells[name], load_recipe(path).rve)
        own = law.particles(*(motion.values[T][:, found.element] for T in (F_NAME, F_DOT_NAME)))
        # its reference is settled anew: the same but for rounding
        np.testing.assert_allclose(found.seen.position, own.position, atol=1e-10)
        of_last = own.extremes()["largest_wall_stretch"][-1]
        assert stretch[found.element] == pytest.approx(of_last, rel=1e-9)
        assert zoom_into(rest, (25.0, y)).cell == name
    assert stretch[1] != pytest.approx(stretch[0], rel=1e-5)
    del motion.values[CELL]
    with pytest.raises(
        FileError, match="no plant_cell of elements in it; run it again with --fresh"
    ):
        cell_numbers(motion, recipes_of(read_record(run)))


@pytest.mark.parametrize(
    ("point", "sentence"),
    [
        (
            "200,50",
            "point: (200, 50) µm; it must lie within the mesh, which reaches from (0, 0) to "
            "(100, 100) µm",
        ),
        ("200", "--point: '200'; it must be two numbers X,Y in µm"),
    ],
)
def test_points_that_are_none(study, point, sentence):
    refused = call("zoom", study[1], "--point", point, code=1)
    assert refused.stderr == f"error: {sentence}\n"


def test_folders_without_a_run_or_its_fields(study, tmp_path):
    refused = call("zoom", tmp_path, "--point", "1,1", code=1)
    assert f"{tmp_path}: no run.json, so not a run; make one with `surrofe2 run`" in refused.stderr
    shutil.copy(study[1] / "run.json", tmp_path)
    record = read_record(tmp_path)
    without = {name: part for name, part in record.recipe.items() if name != "cell"}
    with pytest.raises(InputError, match="law: OwnLaw; it has no plant cells to look into"):
        recipes_of(replace(record, law="OwnLaw", recipe=without))
    refused = call("zoom", tmp_path, "--point", "1,1", code=1)
    assert f"{tmp_path}: the run is finished and has no fields" in refused.stderr


def test_the_example_of_the_docs(study, seen, tmp_path, monkeypatch):
    text = (ROOT / "docs/howto/results.md").read_text(encoding="utf-8")
    _, _, part = text.partition("## Inside the plant cells")
    code = part.split("```python\n")[1].split("```")[0]
    shutil.copytree(study[1], tmp_path / "out" / "run")
    monkeypatch.chdir(tmp_path)
    found = {}
    exec(code, found)
    expected = seen[1].extremes()["largest_wall_stretch"]
    np.testing.assert_allclose(found["stretch"], expected, rtol=1e-7)
    assert (tmp_path / "out" / "look" / "zoom.png").exists()


def test_a_uniform_fluid_fills_its_plant_cells(tmp_path):
    """Triangles of each plant cell, as large as it is, with its pressure; and a picture of them."""
    cell = CellParameters(arrangement="voronoi", cells=4)
    law, F = RveLaw(cell), np.array([np.eye(2), [[1.01, 0.02], [0.0, 0.98]]])
    seen = law.particles(F, 0.0 * F)
    write_rve_fields(tmp_path, seen, np.array([0.0, 1.0]))
    with meshio.xdmf.TimeSeriesReader(tmp_path / "plant-cells.xdmf") as reader:
        points, (triangles,) = reader.read_points_cells()
        _, at_points, in_cells = reader.read_data(1)
    corners = (points + at_points["displacement_um"])[triangles.data][:, :, :2]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    assert area.sum() == pytest.approx(2500.0 * np.linalg.det(F[1]), rel=1e-12)
    pressure = np.ravel(in_cells["fluid_pressure_MPa"])
    assert np.unique(pressure).size == 4
    assert (pressure * area).sum() == pytest.approx((seen.pressure[1] * areas_of(seen, 1)).sum())
    bars = draw_cells(Figure().add_subplot(), seen, 1)
    areas = bars[1][1]
    assert isinstance(areas, PolyCollection)
    assert len(areas.get_paths()) == len(areas.get_array())


def areas_of(seen, k):
    """(cells,) areas of plant cells of RVE k."""
    return rim_areas(seen.rims, seen.position[k], seen.F[k] @ seen.lattice)
