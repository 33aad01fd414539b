"""moduli, with memory and stability, over plant cells."""

import json
from functools import partial

import pytest

from surrofe2.cli import console
from surrofe2.questions import stability
from surrofe2.store.store import locked_file, read_json, write_json
from tests.cli.conftest import call


def test_moduli(tmp_path, monkeypatch):
    monkeypatch.setattr(console, "SELDOM", 0.0)
    path = tmp_path / "moduli.json"
    done = call("moduli", "--preset", "water", "--turgor", "2.5", "--out", path)
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
    alone = call("moduli", "--preset", "water", "--initialisation", "elastic")
    assert alone.stdout.splitlines()[-1].startswith("moduli: elastic and viscous, of "), "no file"


WATER = "moduli", "--cell", "water", "--initialisation", "elastic"


@pytest.mark.slow
def test_memory_gives_a_verdict_and_is_kept(tmp_path):
    memory = partial(call, *WATER, "--memory", tmp_path)
    done = memory()
    assert done.stdout.splitlines()[-2].startswith("Motions as fast as 17 µs can be")
    assert (tmp_path / "memory-water.png").stat().st_size > 10_000
    record = read_json(tmp_path / "memory-water.json")
    assert record["cell"]["fluid_particle_mass"] == 0.27
    assert record["units"]["largest_difference"] == "µN/µm"
    with locked_file(tmp_path / "memory-water.json"):
        refused = memory("--fresh", code=1)
    assert f"error: {tmp_path / 'memory-water.json'}: in use by" in refused.stderr
    assert "memory-water.json, there already" in memory().stdout
    refused = memory("--period", "20", code=1)
    assert "asked.period: this call has 20.0, what is there 17.0" in refused.stderr
    changed = {**record, "cell": {**record["cell"], "viscosity": 9.0}}
    write_json(tmp_path / "memory-water.json", changed)
    refused = memory(code=1)
    assert "cell.viscosity: this call has 0.1, what is there 9.0" in refused.stderr


def test_the_map_of_stability_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(stability, "stability", partial(stability.stability, points=3))
    done = call(*WATER, "--stability", tmp_path)
    assert "simple shear" in done.stdout
    assert (tmp_path / "stability-water.png").exists()
