"""The script of the docs that draws from the fields of a run."""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.image import imread

from tests.conftest import ROOT
from tests.report.made_runs import made_runs


@pytest.mark.slow
def test_three_pictures_of_a_run(recipe, tmp_path):
    _, cached = made_runs(recipe, tmp_path)
    script = ROOT / "docs" / "draw_fields.py"
    words = [sys.executable, "-W", "error", script, cached, tmp_path / "pictures"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    drawn = sorted((tmp_path / "pictures").iterdir())
    assert [path.name for path in drawn] == ["course.png", "points.png", "stress.png"]
    for path in drawn:
        seen = (255.0 * imread(path)[:, :, :3]).astype(int).reshape(-1, 3)
        colours = np.unique(seen[np.ptp(seen, axis=1) > 30], axis=0)
        assert len(colours) > 20, f"{path.name} is blank"
