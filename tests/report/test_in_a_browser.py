"""The page in a headless Chromium: it says nothing wrong, is not blank, and keys work."""

from __future__ import annotations

import re

import numpy as np
import pytest

from surrofe2.workflow.report import write_report
from tests.report.browser import PROGRAM, Browser
from tests.report.made_runs import made_runs

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="no Chromium here")

COLOURS = """(() => { const c = document.getElementById('canvas');
const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data, seen = new Set();
for (let k = 0; k < d.length; k += 4) if (d[k + 3] == 255) seen.add(d[k] + 256 * d[k + 1]);
return seen.size; })()"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture
def page(recipe, tmp_path, browser):
    browser.complaints.clear()
    return write_report(made_runs(recipe, tmp_path), tmp_path / "report.html")


@pytest.mark.parametrize("width", [360, 1440])
def test_seen_at_a_width(browser, page, width):
    browser.show(page, width)
    assert browser.value("document.documentElement.scrollWidth") <= width
    assert browser.value(COLOURS) > 3
    wide = "[...document.querySelectorAll('img.chart')].map(e => e.clientWidth)"
    shown = [each for each in browser.value(wide) if each]
    assert all(min(250, width) <= each <= width for each in shown)
    assert browser.complaints == []


def test_keys_and_controls(browser, page):
    browser.show(page, 1440)
    frame = "+document.getElementById('frame').value"
    last = browser.value("+document.getElementById('frame').max")
    browser.value("document.getElementById('canvas').focus()")
    for key, expected in (("Home", 0), ("ArrowRight", 1), ("End", last), ("ArrowLeft", last - 1)):
        browser.press(key)
        assert browser.value(frame) == expected
    browser.press("Home")
    before = browser.picture()
    browser.press("End")
    assert not np.array_equal(before, browser.picture()), "the tissue does not move"
    browser.press(" ")
    assert browser.value("document.getElementById('play').textContent") == "Pause"
    moved = (
        "new Promise(done => setTimeout(() => done(+document.getElementById('frame').value), 1500))"
    )
    assert 0 < browser.value(moved) <= last
    browser.press(" ")
    assert browser.value("document.getElementById('play').textContent") == "Play"
    browser.value(
        "(() => { const w = document.getElementById('which'); w.value = 1;"
        "w.dispatchEvent(new Event('change')); const c = document.getElementById('colour');"
        "c.value = [...c.options].findIndex(o => o.text == 'stress source');"
        "c.dispatchEvent(new Event('change')); })()"
    )
    told = browser.value("document.getElementById('sources').innerText")
    assert "network" in told
    assert "RVE: out of the domain" in told
    assert browser.value("document.getElementById('canvas').ariaLabel").startswith("cached, stress")
    # Tab reaches the controls one after the other.
    browser.value("document.getElementById('canvas').focus()")
    browser.press("Tab")
    assert browser.value("document.activeElement.id") == "play"
    browser.press("Tab")
    assert browser.value("document.activeElement.id") == "frame"
    assert browser.complaints == []


def test_on_paper_and_without_scripts(browser, page):
    still = "getComputedStyle(document.querySelector('.still')).display != 'none'"
    player = "getComputedStyle(document.getElementById('player')).display != 'none'"
    browser.show(page, 1440)
    assert browser.value(f"[{still}, {player}]") == [False, True]
    browser.media("print")
    assert browser.value(f"[{still}, {player}]") == [True, False]
    assert (browser.picture()[0, 0, :3] > 0.9).all(), "paper is white"
    paper = browser.paper()
    assert paper.startswith(b"%PDF")
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 40
    browser.show(page, 1440, script=False)
    seen = browser.picture()
    assert len(np.unique((255.0 * seen[:, :, :3]).astype(int).reshape(-1, 3), axis=0)) > 20
    assert browser.complaints == []
