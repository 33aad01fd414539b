"""Runs of recipes that state their problem: the bar again, contact, a mesh from a file."""

import csv
import json

import numpy as np
import pytest

from surrofe2.store.run_folder import read_record, read_run
from tests.cli.conftest import RUN_FILES
from tests.conftest import BAR, RANGE, changed
from tests.laws import SoftLaw
from tests.store.gmsh_files import TRIANGLES

LEAF = TRIANGLES.replace(
    "0 0 5\n2 0 5\n2 2 5\n0 2 5\n1 1 5", "0 0 5\n100 0 5\n100 100 5\n0 100 5\n50 50 5"
)

PRESSED = f"""{RANGE}
[mesh]
file = "leaf.msh"
[mesh.boundaries]
upper = {{ half_plane = {{ through = [0.0, 100.0], normal = [0.0, 1.0] }} }}
[conditions]
base = {{ kind = "fixed", on = "base" }}
[bodies.plate]
plane = {{ normal = [0.0, -1.0] }}
on = "upper"
position = [0.0, 100.0]
displacement = [0.0, -2.0]
amplitude = {{ kind = "ramp", end = 8.0, smooth = true }}
[watch]
middle = [50.0, 50.0]
"top, right" = [100.0, 100.0]
[time]
duration = 8.0
output_interval = 1.0
frames = 3
"""
TWICE = """
[conditions.again]
kind = "prescribed_motion"
on = "left"
displacement = [1.0, 0.0]
amplitude = { kind = "ramp", end = 4.0 }
"""


@pytest.fixture
def run(invoke):
    """run(path, folder): that of a recipe by RVEs."""
    return lambda path, folder, **more: invoke("run", path, "--law", "rve", "--out", folder, **more)


def test_the_bar_is_the_same_by_load_and_by_conditions(run, recipe_path, written, tmp_path):
    run(recipe_path, tmp_path / "load")
    done = run(written(RANGE + BAR, "bar.toml"), tmp_path / "stated")
    assert done.stdout.startswith(f"{tmp_path / 'stated'}: 4 µs by rve in ")
    by_load, stated = (read_run(tmp_path / name).curve for name in ("load", "stated"))
    np.testing.assert_array_equal(by_load.t, stated.t)
    np.testing.assert_allclose(stated.displacement, by_load.displacement, rtol=0, atol=1e-12)
    assert abs(by_load.displacement).max() > 0.1
    one, other = ((tmp_path / name / "energies.csv").read_text() for name in ("load", "stated"))
    assert one == other


def test_a_pressed_mesh_from_a_file(invoke, run, written, tmp_path):
    written(LEAF, "leaf.msh")
    path, folder = written(PRESSED), tmp_path / "rve"
    done = run(path, folder)
    assert sorted(each.name for each in folder.iterdir()) == RUN_FILES
    record = read_record(folder)
    assert record.problem["boundaries"] == {"base": 1, "tip": 1, "upper": 1}
    assert record.problem["regions"] == {"leaf": 4}
    assert (record.problem["elements"], record.problem["nodes_per_element"]) == (4, 6)
    assert record.problem["points"] == 12
    assert len(record.recipe["mesh"]["sha256"]) == 64
    assert record.duration == 8.0
    with (folder / "curve.csv").open(encoding="utf-8", newline="") as file:
        header = next(csv.reader(file))
    assert header == ["t_us", "u_x_um", "u_y_um", "u_x_um top, right", "u_y_um top, right"]
    history = read_run(folder).history
    force = history["force plate y"]
    assert force[0] > -1e-9 > force[-1]  # the plate presses the tissue down
    assert force.argmin() < len(force) - 1  # it relaxes when the plate comes to rest
    assert history["force base y"][-1] > 100.0
    assert history["position plate y"][-1] == pytest.approx(-2.0)
    assert history["penetration plate"].min() >= 0.0
    deepest = history["penetration plate"].max()
    assert record.problem["penetration"] == {"plate": deepest}
    assert f"contact: plate penetrates by {deepest:.2g} µm" in done.output
    names = (folder / "history.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert {"force plate y_uN", "position plate y_um", "penetration plate_um"} <= set(names)
    energies = (folder / "energies.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert {"plate_pJ", "contact_pJ", "dissipated_pJ", "dissipated leaf_pJ"} <= set(energies)

    soft = tmp_path / "soft"
    run(path, soft, law=SoftLaw(a=45.0))
    compared = invoke("compare", folder, soft, "--out", tmp_path / "comparison")
    stored = json.loads((tmp_path / "comparison" / "comparison.json").read_text(encoding="utf-8"))
    found = stored["runs"][0]["forces"]["plate"]
    there, here = (read_run(each).history for each in (folder, soft))
    apart = np.hypot(*(here[f"force plate {i}"] - there[f"force plate {i}"] for i in "xy"))
    assert found["largest"] * found["scale"] == pytest.approx(apart.max(), rel=1e-12)
    table = compared.stdout[compared.stdout.index("Forces on the tissue") :]
    assert f"{found['scale']:.4g}" in table
    assert f"{100.0 * found['largest']:.3g} %" in table


def test_errors_found_where_a_run_starts_name_the_recipe(run, written, tmp_path):
    path = written(RANGE + BAR + TWICE)
    failed = run(path, tmp_path / "run", code=1)
    assert failed.stderr.startswith("error: recipe.toml: again: component x of the node at (")


def test_a_changed_problem_or_mesh_is_refused(run, written, tmp_path):
    mesh = written(LEAF, "leaf.msh")
    folder = tmp_path / "rve"
    run(written(PRESSED), folder)
    for old, new, told in (
        ("-2.0]", "-2.5]", "bodies.plate.displacement: this call has [0.0, -2.5], what is there "
         "[0.0, -2.0]"),
        ('"top, right" = [100.0, 100.0]\n', "", "watch: this call has ['middle'], what is there "
         "['middle', 'top, right']"),
    ):  # fmt: skip
        refused = run(written(changed(PRESSED, old, new)), folder, code=1)
        assert f"error: {folder}: {told}; change it back" in refused.stderr
    mesh.write_text(LEAF.replace("50 50 5", "51 50 5"), encoding="utf-8")
    refused = run(written(PRESSED), folder, code=1)
    assert f"error: {folder}: mesh.sha256: this call has " in refused.stderr
