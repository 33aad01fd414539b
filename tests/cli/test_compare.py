import json
from shutil import copytree

import pytest

from tests.laws import SoftLaw


@pytest.fixture
def runs(invoke, recipe_path, tmp_path):
    folders = [tmp_path / "stiff", tmp_path / "soft"]
    for folder, stiffness in zip(folders, (50.0, 49.0), strict=True):
        command = "run", recipe_path, "--law", "rve", "--out", folder
        invoke(*command, law=SoftLaw(a=stiffness))
    return folders


def test_comparison(invoke, runs, tmp_path):
    out = tmp_path / "comparison"
    done = invoke("compare", *runs, "--out", out, env={"COLUMNS": "50"})
    assert "\x1b" not in done.output
    result = json.loads((out / "comparison.json").read_text(encoding="utf-8"))
    assert result["reference"] == "stiff"
    (run,) = result["runs"]
    assert run["name"] == "soft"
    assert 0.0 < run["difference"]["rms"] < run["difference"]["largest"] < 0.05
    assert run["speed_up"]["wall_time"] > 0.0
    assert (out / "comparison.png").stat().st_size > 10_000


def test_a_comparison_is_kept_and_one_of_other_runs_refused(invoke, runs, tmp_path):
    out = tmp_path / "comparison"
    invoke("compare", *runs, "--out", out)
    before = (out / "comparison.png").stat().st_mtime_ns
    invoke("compare", *runs, "--out", out)
    assert (out / "comparison.png").stat().st_mtime_ns == before
    third = runs[0].with_name("third")
    copytree(runs[1], third)
    refused = invoke("compare", *runs, third, "--out", out, code=1)
    assert refused.stderr.startswith(f"error: {out / 'comparison.json'}: of.third: this call has ")
    invoke("compare", *runs, third, "--out", out, "--fresh")
