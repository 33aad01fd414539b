import json
from functools import partial

import meshio
import numpy as np
import pytest

from surrofe2.recipe.recipe import ImageSettings, load_recipe
from surrofe2.store.run_folder import read_record, read_run
from surrofe2.tissue import simulation
from tests.cli.conftest import TISSUE_FILES, call
from tests.conftest import changed
from tests.laws import SoftLaw
from tests.questions.test_cell_image import squares


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "out" / "tissue"


@pytest.fixture
def short(changed_recipe):
    """A recipe of 2 × 2 plant cells for a very short time."""
    return changed_recipe("= 4.0", "= 1.0", "[100.0, 50.0]", "[50.0, 25.0]", "= 100.0", "= 50.0")


invoke = partial(call, "tissue", "--threads", "1")


def test_run_folder(short, folder):
    done = invoke(short, "--out", folder)
    assert sorted(path.name for path in folder.iterdir()) == TISSUE_FILES
    stored = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert (stored["status"], stored["law"], stored["solver"]) == ("finished", "tissue", "leapfrog")
    assert stored["recipe"]["tissue"]["micro_step"] == 2e-3
    assert stored["counts"]["steps"] == 500
    assert stored["counts"]["particles"] == 4 * 16 + 117
    curve = read_run(folder).curve
    np.testing.assert_array_equal(curve.t, load_recipe(short).problem().output_times())
    assert curve.displacement[-1, 1] < -0.01
    header = (folder / "energies.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == "t_us,kinetic_pJ,internal_pJ,elastic_pJ,load_pJ,dissipated_pJ,balance_pJ"
    with meshio.xdmf.TimeSeriesReader(folder / "fields.xdmf") as reader:
        points, cells = reader.read_points_cells()
        assert len(points) == stored["counts"]["particles"]
        assert {block.type: len(block.data) for block in cells} == {"line": 120}
        t, at_points, _ = reader.read_data(reader.num_steps - 1)
        assert t == 1.0
        assert at_points["wall"].sum() == 117
        assert at_points["displacement_um"][:, 1].min() <= curve.displacement[-1, 1]
    assert done.stdout.startswith(f"{folder}: 1 µs of 181 particles in ")
    fields, coordinates = read_run(folder).fields_over_time()
    frames = len(coordinates["frame"][1])
    axes, is_wall, _ = fields["field wall"]
    assert (axes, is_wall.shape) == (("frame", "node"), (frames, 181))
    pytest.importorskip("pyvista")
    grid = read_run(folder).to_pyvista()
    assert (grid.n_points, grid.n_cells, grid.point_data["wall"].sum()) == (181, 120, 117)


def test_a_tissue_is_in_time_though_its_recipe_states_a_rest(short, folder, written):
    path = written(short.read_text(encoding="utf-8") + "\n[rest]\nload_steps = 2\n", "rest.toml")
    invoke(path, "--out", folder)
    run = read_run(folder)
    assert not run.is_rest
    assert run.curve.t[-1] == 1.0


@pytest.fixture
def with_step(short, written):
    """with_step(µs): the recipe with a step of its own, as another file."""
    text = short.read_text(encoding="utf-8")
    return lambda step: written(f"{text}\n[tissue]\nmicro_step = {step}\n", "stepped.toml")


def test_interrupted_and_continued(short, folder, with_step, monkeypatch):
    advance = simulation.advance

    def stopping(motion, load_case, settings, start, end):
        if end > 0.5:
            raise KeyboardInterrupt
        return advance(motion, load_case, settings, start, end)

    monkeypatch.setattr(simulation, "advance", stopping)
    stopped = invoke(short, "--out", folder, code=130)
    assert "resume with: surrofe2 tissue" in stopped.stderr
    assert read_record(folder).status == "interrupted"
    monkeypatch.setattr(simulation, "advance", advance)
    other = invoke(with_step(1e-3), "--out", folder, code=1)
    assert "tissue.micro_step: this call has 0.001" in other.stderr
    invoke(short, "--out", folder)
    assert not (folder / "checkpoint.h5").exists()


def test_step_that_is_too_long(with_step, folder):
    failed = invoke(with_step(8e-3), "--out", folder, code=1)
    assert "tissue.micro_step: 0.008 µs; at most" in failed.stderr
    assert not (folder / "run.json").exists()


def test_irregular_tissue_with_undrained_sap_names_its_step(changed_recipe, folder):
    """And has the plant cells of one RVE, in the files that squares have."""
    recipe = changed_recipe(
        "= 4.0", "= 0.5",
        'preset = "printed"',
        'preset = "printed"\narrangement = "voronoi"\ncells = 16\nsap_bulk_modulus = 2200.0',
    )  # fmt: skip
    done = invoke(recipe, "--out", folder)
    assert "undrained sap (sap_bulk_modulus 2200 MPa) bears 0.0" in done.stdout
    assert "drained sap would bear 0.0" in done.stdout
    assert sorted(path.name for path in folder.iterdir()) == TISSUE_FILES
    run = read_run(folder)
    assert run.curve.displacement[-1, 1] < -0.01
    assert run.energies["dissipated"][-1] > 0.0


STATED = """
[cells.skin]
preset = "water"
wall_stiffness = 5000.0
regions = ["upper"]
[cells.parenchyma]
preset = "water"
regions = ["rest"]
[mesh]
width = 50.0
height = 50.0
elements = [2, 2]
[mesh.regions]
upper = { box = [0, 25, 50, 50] }
[conditions]
base = { kind = "symmetry", on = "bottom" }
[conditions.grip]
kind = "prescribed_motion"
on = "left"
displacement = [0.2, "free"]
amplitude = { kind = "ramp", end = 0.5, smooth = true }
[bodies.plate]
plane = { normal = [0, -1] }
on = "top"
position = [0, 50]
displacement = [0, -0.5]
amplitude = { kind = "ramp", end = 1.0, smooth = true }
[watch]
top = [25.0, 50.0]
right = [50.0, 25.0]
[time]
duration = 1.0
output_interval = 0.1
"""


@pytest.fixture
def stated(written):
    """stated(old, new, …): a recipe of its own problem, with parts of it replaced."""
    return lambda *changes: written(changed(STATED, *changes))


@pytest.mark.slow
def test_problem_of_its_own_beside_finite_elements(stated, folder, tmp_path, monkeypatch):
    """Two cell types, sliding base, driven side and plate: the names are those of FE²."""
    recipe = stated()
    invoke(recipe, "--out", folder)
    history = read_run(folder).history
    assert history["position plate y"][-1] == pytest.approx(-0.5)
    assert history["mean displacement left x"][-1] == pytest.approx(0.2)
    assert history["force plate y"][-1] < -10.0
    assert history["force base x"].tolist() == [0.0] * 11
    header = (folder / "energies.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == (
        "t_us,kinetic_pJ,internal_pJ,elastic_pJ,contact_pJ,motion_pJ,"
        "contact dissipated_pJ,dissipated_pJ,"
        "balance_pJ"
    )
    monkeypatch.setattr("surrofe2.rve.RveLaw", SoftLaw().of)
    rve, comparison = tmp_path / "rve", tmp_path / "comparison"
    call("run", recipe, "--law", "rve", "--out", rve)
    assert set(history) <= set(read_run(rve).history)
    call("compare", folder, rve, "--out", comparison)
    found = json.loads((comparison / "comparison.json").read_text(encoding="utf-8"))
    assert found["reference"] == folder.name
    assert set(found["runs"][0]["forces"]) == {"base", "grip", "plate"}
    invoke(recipe, "--out", folder)


@pytest.mark.slow
def test_all_conditions_and_bodies_of_a_recipe_act_on_a_tissue(stated, folder):
    """A rough corner, a pressure, a foundation, and a region that moves as a whole."""
    recipe = stated(
        "plane = { normal = [0, -1] }", "corner = { axis = [0, 1], angle = 170, radius = 5 }",
        "position = [0, 50]", "position = [25, 50]\nfriction = 0.3\ndamping = 2.0",
        '"symmetry", on = "bottom"', '"foundation", on = "bottom", stiffness = 5.0, damping = 1.0',
        "[conditions]", '[conditions]\ngas = { kind = "pressure", on = "right", pressure = 3.0 }',
        'on = "left"', 'on = "upper"',
    )  # fmt: skip
    invoke(recipe, "--out", folder)
    done = read_run(folder)
    history, energies = done.history, done.energies
    assert history["force gas x"][0] == pytest.approx(-3.0 * 50.0)
    assert history["force plate y"][-1] < -5.0
    for name in ("base", "gas", "motion", "contact", "contact dissipated"):
        assert abs(energies[name]).max() > 0.0
    assert abs(energies["balance"]).max() < 0.02 * energies["motion"].max()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (("height = 50.0", "height = 60.0"),
         "mesh.height: 60; a tissue needs a whole number of plant cells of 25 µm: take 50 or 75"),
        (("position = [0, 50]", "position = [0, 49]"),
         "bodies.plate.position: [0.0, 49.0]; the tissue begins 1 µm inside it, at (0, 50) µm"),
        (("wall_stiffness = 5000.0", "repulsion_cutoff = 9.0"),
         "cell.repulsion_cutoff: 10 and 9; plant cells of one tissue must share it"),
        (("[0, 25, 50, 50]", "[0, 25, 40, 50]", "elements = [2, 2]", "elements = [5, 2]",
          '["rest"]', '["lower", "side"]', "[mesh.regions]", """[mesh.regions]
lower = { box = [0, 0, 50, 25] }
side = { box = [37, 25, 50, 50] }"""),
         "cells.parenchyma.regions: side; the plant cell at"),
    ],
)  # fmt: skip
def test_what_a_tissue_does_not_take_is_one_line(stated, folder, changes, said):
    refused = invoke(stated(*changes), "--out", folder, code=1)
    assert said in refused.stderr
    assert refused.stderr.count("\n") == 1
    assert not folder.exists()


OUTLINED = """
[image]
file = "cells.npy"
pixel = 10.0
[cell]
preset = "apple"
[mesh]
width = 600.0
height = 600.0
elements = [1, 1]
[conditions.foot]
kind = "fixed"
on = "bottom"
[conditions.grip]
kind = "prescribed_motion"
on = "top"
displacement = [0.0, -1.0]
amplitude = { kind = "ramp", end = 0.1 }
[watch]
end = [0.0, 600.0]
[time]
duration = 0.1
output_interval = 0.05
[tissue]
residual = 1.0
"""


def test_the_outlines_of_an_image_are_a_tissue(written, folder, tmp_path):
    """Four by four cells with an air space; with another image the folder is another run's."""
    image = squares(4, 4, side=15)
    image[26:34, 26:34] = 0
    np.save(tmp_path / "cells.npy", image)
    recipe = written(OUTLINED, "outlined.toml")
    done = invoke(recipe, "--out", folder)
    assert (
        "image: cells that the border of the image cuts, closed by a wall there: 12" in done.stdout
    )
    assert "image: air spaces: 1, 1.8 % of the image; a pressure on the outline does" in done.stdout
    run = read_run(folder)
    assert run.curve.displacement[-1, 1] == pytest.approx(-1.0)
    assert run.history["force grip y"][-1] < 0.0
    assert (folder / "input" / "image.npy").read_bytes() == (tmp_path / "cells.npy").read_bytes()
    kept = load_recipe(folder / "input" / "recipe.toml")
    assert kept.image == ImageSettings(file="image.npy", pixel=10.0)
    np.save(tmp_path / "cells.npy", np.flipud(image) + 1)
    other = invoke(recipe, "--out", folder, code=1)
    assert "image.sha256" in other.stderr


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (('file = "cells.npy"', ""), "image.file: missing"),
        (("pixel = 10.0", "pixel = 0.0"), "image.pixel: 0.0; it must be positive"),
        (("cells.npy", "cell.npy"), "image.file: "),
        (("width = 600.0", "width = 700.0"), "the image is 600 × 600 µm, from (0, 0)"),
        (('preset = "apple"', 'preset = "printed"'), "cell.fluid is sph"),
    ],
)
def test_an_image_that_is_no_tissue_is_refused_in_one_line(
    written, folder, tmp_path, changes, said
):
    np.save(tmp_path / "cells.npy", squares(4, 4, side=15))
    refused = invoke(written(changed(OUTLINED, *changes), "no.toml"), "--out", folder, code=1)
    assert said in refused.stderr
    assert refused.stderr.count("\n") <= 3
    assert not folder.exists()
