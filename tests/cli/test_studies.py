"""reproduce and moduli over true plant cells."""

import json

import pytest
from typer.testing import CliRunner

from surrofe2.cli import app, progress
from surrofe2.io.files import read_json, write_json
from surrofe2.io.lock import file_lock, locked_file
from tests.io.test_locks import leave_lock


def invoke(*arguments):
    return CliRunner().invoke(app, [str(entry) for entry in arguments], env={"COLUMNS": "160"})


def test_reproduce_writes_figure_table_and_numbers(tmp_path):
    done = invoke("reproduce", "fig5", "--preset", "water", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    assert (tmp_path / "fig5-water.png").stat().st_size > 10_000
    assert (tmp_path / "fig5-water.csv").read_text(encoding="utf-8").startswith("F_xy (1),")
    record = read_json(tmp_path / "fig5-water.json")
    assert record["preset"] == "water"
    assert record["cell"]["fluid_particle_mass"] == 0.27
    assert record["units"]["largest_difference"] == "µN/µm"
    with locked_file(tmp_path / "fig5-water.json"):
        refused = invoke("reproduce", "fig5", "--preset", "water", "--out", tmp_path, "--fresh")
    assert f"error: {tmp_path / 'fig5-water.json'}: in use by" in refused.stderr
    lock = file_lock(tmp_path / "fig5-water.json")
    leave_lock(lock)
    kept = invoke("reproduce", "fig5", "--preset", "water", "--out", tmp_path)
    assert kept.exit_code == 0
    assert not lock.exists()
    assert "fig5-water.json, there already" in kept.stdout
    changed = {**record, "cell": {**record["cell"], "viscosity": 9.0}}
    write_json(tmp_path / "fig5-water.json", changed)
    refused = invoke("reproduce", "fig5", "--preset", "water", "--out", tmp_path)
    assert refused.exit_code == 1
    assert "cell.viscosity: this call has 0.1, what is there 9.0" in refused.stderr


@pytest.mark.slow
def test_reproduce_fig8_without_the_tissue_says_so(tmp_path):
    done = invoke(
        "reproduce", "fig8", "--preset", "water", "--out", tmp_path, "--no-tissue", "--meshes", "2",
        "--duration", "60",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "full tissue not computed" in done.stdout
    record = json.loads((tmp_path / "fig8-water.json").read_text(encoding="utf-8"))
    assert record["results"]["full_tissue"] == "not computed"
    assert [row["run"] for row in record["results"]["rows"]] == [
        "cauchy-born 2x2",
        "elastic 2x2",
        "constrained-runs 2x2",
        "slow-manifold 2x2",
    ]
    refused = invoke("reproduce", "fig8", "--out", tmp_path, "--meshes", "four")
    assert "--meshes: 'four'; it must be integers" in refused.stderr


def test_moduli(tmp_path, monkeypatch):
    monkeypatch.setattr(progress, "SELDOM", 0.0)
    path = tmp_path / "moduli.json"
    done = invoke("moduli", "--preset", "water", "--turgor", "2.5", "--out", path)
    assert done.exit_code == 0, done.output
    assert "turgor 2.5 MPa" in done.stdout
    assert "Viscous moduli, MPa µs" in done.stdout
    assert "moduli: 50 %" in done.stderr
    assert done.stdout.splitlines()[-1].startswith(f"{path}: elastic and viscous, of ")
    record = json.loads(path.read_text(encoding="utf-8"))
    assert record["turgor_mean_MPa"] == pytest.approx(2.5)
    rows = record["tables"]["Elastic moduli, MPa"]
    assert [row["initialisation"] for row in rows] == [
        "cauchy-born", "elastic", "constrained-runs", "slow-manifold"
    ]  # fmt: skip
    assert rows[0]["bulk"] > rows[1]["bulk"] > 0.0
    alone = invoke("moduli", "--preset", "water", "--initialisation", "elastic")
    assert alone.stdout.splitlines()[-1].startswith("moduli: elastic and viscous, of "), "no file"


@pytest.mark.slow
def test_memory_gives_a_verdict(tmp_path):
    done = invoke("reproduce", "memory", "--preset", "water", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    assert done.stdout.splitlines()[-2].startswith("sound: a cache on (F, Ḟ) holds")
    assert (tmp_path / "memory-water.png").exists()
