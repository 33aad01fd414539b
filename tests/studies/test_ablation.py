"""The ablation over true plant cells, with networks too small to be of use."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from typer.testing import CliRunner

from surrofe2.cli import app
from surrofe2.sampling import SamplingRange, sample
from surrofe2.stress_samples import StressSamples
from surrofe2.studies import ablation
from surrofe2.studies.ablation import Row, contenders, is_of
from surrofe2.studies.ablation_rivals import Folded, LinearFromNearest, NearestNeighbours
from surrofe2.surrogate import TrainingSettings
from tests.surrogate.lattice_law import CELL, RANGE, lattice_samples


def invoke(*arguments):
    return CliRunner().invoke(app, [str(entry) for entry in arguments], env={"COLUMNS": "160"})


@pytest.fixture
def few_points(monkeypatch):
    monkeypatch.setattr(ablation, "TEST_POINTS", 256)


@pytest.mark.slow
@pytest.mark.usefixtures("few_points")
def test_one_command_writes_figure_table_and_numbers(recipe_path, tmp_path):
    done = invoke("ablation", recipe_path, "--out", tmp_path, "--counts", "64,128")
    assert done.exit_code == 0, done.output
    stem = tmp_path / "ablation-printed-constrained-runs"
    record = json.loads(stem.with_suffix(".json").read_text(encoding="utf-8"))
    rows = {(row["contender"], row["samples"]): row for row in record["results"]["rows"]}
    assert set(rows) == {(name, count) for name in contenders() for count in (64, 128)}
    assert all(row["query"] > 0.0 for row in rows.values())
    best, plain = rows["+ polynomial", 128], rows["plain MLP", 128]
    assert best["answered"] == plain["answered"] == 1.0
    assert best["rms"] < 0.01 * plain["rms"]
    assert rows["linear from nearest", 128]["rms"] < 0.1 * rows["nearest neighbours", 128]["rms"]
    lines = stem.with_suffix(".md").read_text(encoding="utf-8").splitlines()
    assert [line.split("|")[1].strip(" *") for line in lines[2:]] == list(contenders())
    assert stem.with_suffix(".png").stat().st_size > 10_000
    assert not stem.with_suffix(".unfinished.json").exists()
    refused = invoke("ablation", recipe_path, "--out", tmp_path)
    assert refused.exit_code == 1
    assert refused.stderr == f"error: {stem}.png: exists; replace it with --force\n"


@pytest.mark.usefixtures("few_points")
def test_an_interrupted_ablation_goes_on(recipe_path, tmp_path, monkeypatch):
    asked, learn = [], ablation._learn

    def learn_or_stop(name, *arguments):
        if len(asked) == 3:
            raise KeyboardInterrupt
        asked.append(name)
        return learn(name, *arguments)

    monkeypatch.setattr(ablation, "_NETWORKS", {"plain MLP": ablation._NETWORKS["plain MLP"]})
    monkeypatch.setattr(ablation, "_learn", learn_or_stop)
    command = ("ablation", recipe_path, "--out", tmp_path, "--counts", "64")
    stopped = invoke(*command)
    assert stopped.exit_code == 130
    assert "--counts 64 --resume" in stopped.stderr
    other = invoke(*command[:-1], "128", "--resume")
    assert other.exit_code == 1
    assert "of another recipe or other counts" in other.stderr
    monkeypatch.setattr(
        ablation, "_learn", lambda name, *rest: (asked.append(name), learn(name, *rest))[1]
    )
    assert invoke(*command, "--resume").exit_code == 0
    assert asked == list(contenders())


def test_wrong_counts(recipe_path, tmp_path):
    refused = invoke("ablation", recipe_path, "--out", tmp_path, "--counts", "12")
    assert refused.exit_code == 1
    assert refused.stderr.startswith("error: --counts: '12'; it must be")


@pytest.mark.parametrize("regressor", [NearestNeighbours, LinearFromNearest])
def test_rivals_have_the_symmetry_of_the_square(regressor):
    """σ(F Q) with Q of the square's group, and σ(Q F) = Q σ Qᵀ."""
    samples = lattice_samples(200)
    shape = (200, 2, 2, 2, 2)
    slopes = np.random.default_rng(0).normal(size=(2, *shape))
    samples = StressSamples(
        **{name: getattr(samples, name) for name in ("F", "F_dot", "stress", "status", "cell")},
        initialisation="elastic", range=RANGE, seed=1, P_by_F=slopes[0], P_by_F_dot=slopes[1],
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
    found = [name for name in contenders() if is_of(name, TrainingSettings())]
    assert len(found) == 1
    assert not any(is_of(name, TrainingSettings(baseline_degree=2)) for name in contenders())
    assert set(asdict(Row("a", 1, None, None, 0.0, 1.0, 1.0))) == set(Row.__slots__)
