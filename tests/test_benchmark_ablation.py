"""The ablation over true plant cells, with networks too small to be of use."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import __main__ as runner
from benchmarks import ablation
from benchmarks.rivals import Folded, LinearFromNearest, NearestNeighbours
from benchmarks.setting import Setting
from surrofe2.sampling import SamplingRange, sample
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate import TrainingSettings
from tests.laws import CELL, RANGE, lattice_samples


class TinySetting(Setting):
    """Quick mode with networks that take a second to train."""

    def recipe(self, preset):
        recipe = super().recipe(preset)
        return replace(
            recipe,
            training=replace(recipe.training, hidden=(4,), iterations=40),
        )


@pytest.mark.slow
def test_it_writes_figure_table_and_numbers(tmp_path):
    rows = ablation.run(TinySetting(quick=True, out=tmp_path))
    assert [row.name for row in rows] == [
        f"{name}, {count} samples: RMS error" for count in (64, 128) for name in ablation.CONTENDERS
    ]
    stem = tmp_path / "ablation-printed"
    record = json.loads(stem.with_suffix(".json").read_text(encoding="utf-8"))
    found = {(row["contender"], row["samples"]): row for row in record["results"]["all"]}
    assert all(row["query"] > 0.0 for row in found.values())
    best, plain = found["+ polynomial", 128], found["plain MLP", 128]
    assert best["answered"] == plain["answered"] == 1.0
    assert best["rms"] < 0.01 * plain["rms"]
    assert found["linear from nearest", 128]["rms"] < 0.1 * found["nearest neighbours", 128]["rms"]
    lines = stem.with_suffix(".md").read_text(encoding="utf-8").splitlines()
    assert [line.split("|")[1].strip(" *") for line in lines[2:]] == list(ablation.CONTENDERS)
    assert stem.with_suffix(".png").stat().st_size > 10_000


def test_it_runs_on_request_only(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(ablation, "run", lambda setting: [])
    assert runner.main(["--quick", "--only", "ablation", "--out", str(tmp_path)]) == 0
    assert ablation.TITLE in capsys.readouterr().out
    assert "ablation" not in runner.NAMES


@pytest.mark.parametrize("regressor", [NearestNeighbours, LinearFromNearest])
def test_rivals_have_the_symmetry_of_the_square(regressor):
    """σ(F Q) with Q of the square's group, and σ(Q F) = Q σ Qᵀ."""
    samples = lattice_samples(200)
    slopes = np.random.default_rng(0).normal(size=(2, 200, 2, 2, 2, 2))
    samples = StressSamples(
        F=samples.F, F_dot=samples.F_dot, stress=samples.stress, status=samples.status,
        cell=samples.cell, initialisation="elastic", range=RANGE, seed=1,
        P_by_F=slopes[0], P_by_F_dot=slopes[1],
    )  # fmt: skip
    law = Folded(regressor(), samples)
    F, F_dot = sample(SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=0.01), 20, 7)
    stress = law.stress(F, F_dot)
    for Q in (np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([[1.0, 0.0], [0.0, -1.0]])):
        np.testing.assert_allclose(
            law.stress(Q @ F @ Q.T, Q @ F_dot @ Q.T), Q @ stress @ Q.T, rtol=1e-9, atol=1e-9
        )
    assert samples.cell == CELL


def test_the_recipe_is_found_among_the_contenders():
    found = [name for name in ablation.CONTENDERS if ablation.is_of(name, TrainingSettings())]
    assert found == ["+ polynomial"]
    other = TrainingSettings(baseline_degree=2)
    assert not any(ablation.is_of(name, other) for name in ablation.CONTENDERS)
