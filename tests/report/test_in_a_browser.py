"""The page in a headless Chromium: its script runs without a complaint, and keys work."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from matplotlib.image import imread

from surrofe2.report.page import write_report
from tests.report.made_runs import made_runs

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(PROGRAM is None, reason="no Chromium here")

KEYS = """<script>const canvas = document.getElementById('canvas'), seen = [];
for (const key of ['Home', 'ArrowRight', 'End', 'ArrowLeft']) {
  canvas.dispatchEvent(new KeyboardEvent('keydown', { key, cancelable: true }));
  seen.push(+document.getElementById('frame').value);
}
document.title = JSON.stringify([+document.getElementById('frame').max, ...seen]);</script>"""


def chromium(folder, path, *options):
    words = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0"]
    call = [PROGRAM, *words, f"--user-data-dir={folder / 'profile'}", *options, path.as_uri()]
    done = subprocess.run(call, capture_output=True, text=True, check=True, timeout=120)
    assert "CONSOLE" not in done.stderr, done.stderr
    return done.stdout


@pytest.fixture
def page(recipe, tmp_path):
    return write_report(made_runs(recipe, tmp_path), tmp_path / "report.html")


def test_the_script_shows_runs_and_obeys_keys(page, tmp_path):
    shown = chromium(tmp_path, page, "--dump-dom")
    assert 'class="scripted"' in shown
    assert re.search(r'<output id="clock"[^>]*>t = [\d.]+ µs</output>', shown)
    text = re.sub(r"<meta http-equiv[^>]*>", "", page.read_text(encoding="utf-8"))
    page.write_text(text.replace("</body>", f"{KEYS}</body>"), encoding="utf-8")
    title = re.search(r"<title>(.*?)</title>", chromium(tmp_path, page, "--dump-dom"))[1]
    last, *seen = json.loads(title)
    assert seen == [0, 1, last, last - 1]


@pytest.mark.parametrize("width", [500, pytest.param(1440, marks=pytest.mark.slow)])
def test_the_page_is_not_blank(page, tmp_path, width):
    picture = tmp_path / "page.png"
    chromium(tmp_path, page, f"--screenshot={picture}", f"--window-size={width},900")
    pixels = (255.0 * imread(picture)[:, :, :3]).astype(int).reshape(-1, 3)
    assert len(np.unique(pixels, axis=0)) > 20
