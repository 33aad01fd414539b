"""The page of runs: what stands in it, what it leaves out, and that it asks nobody for anything."""

import base64
import hashlib
import json
import re
from copy import deepcopy
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from surrofe2 import Fixed, Problem, Ramp, RigidBody, rectangle, save_run, simulate
from surrofe2.base.errors import InputError
from surrofe2.problem.rigid_bodies import Circle, Corner, Plane
from surrofe2.report.figures import outline
from surrofe2.report.page import bodies_of, fields_of, motion_section, write_report
from surrofe2.store.run_folder import read_record, read_run, write_record
from tests.laws import KelvinVoigt
from tests.report.made_runs import EVIL, RISK, made_runs

VOID = {"meta", "input", "img", "br"}


class Page(HTMLParser):
    """A page of runs: that all its elements end, its words, attributes and scripts."""

    def __init__(self, runs, path):
        super().__init__()
        self.text = write_report(runs, path).read_text(encoding="utf-8")
        self.open, self.words, self.attributes, self.scripts = [], "", [], []
        self.feed(self.text)
        assert not self.open
        self.words = " ".join(self.words.split())

    def handle_starttag(self, tag, attributes):
        self.attributes += [(tag, *each) for each in attributes]
        if tag not in VOID:
            self.open.append(tag)
            if tag == "script":
                self.scripts.append([dict(attributes), ""])

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] == ["script"]:
            self.scripts[-1][1] += data
        elif self.open[-1:] != ["style"]:
            self.words += f" {data}"


@pytest.fixture
def runs(recipe, tmp_path):
    return made_runs(recipe, tmp_path)


@pytest.fixture
def page(runs, tmp_path):
    return Page(runs, tmp_path / "report.html")


def test_what_ran_stands_in_the_page(page):
    for sentence in (
        "cached differs from rve by at most 0.1 % of the largest displacement and is 6 times",
        "including data and training (20 s), 6.8 times slower than full FE²",
        "it pays off after 8 such runs",
        "200 answers of accepted steps came from the cache, 6 from RVEs (6 out of range), 2.91 %",
        "cached, step 3: a finding",
        "cached: audited: 40 of 200 accepted answers",
        "cached: closing audit: 40 of the 200 answers that stand, drawn at random",
        "at most 7.2 % of all are (Clopper–Pearson, 1 − 0.05^(1/40))",
        "cached: the worst error is 0.003 µN/µm",
        f"where the risk was {RISK} (step 7, point 3).",
        "cached, events: 2",
        "Range that was met",
        "No look into the plant cells",
    ):
        assert sentence in page.words
    assert EVIL in page.words
    assert len(page.text) < 3e6


def test_the_policy_allows_what_is_in_the_page_and_nothing_else(page):
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]+)"', page.text)
    assert policy.startswith("default-src 'none'; img-src data:; ")
    (style,) = re.findall(r"<style>(.*?)</style>", page.text, re.S)
    data, script = page.scripts
    assert data[0]["type"] == "application/json"
    for content, rule in ((style, "style-src"), (script[1], "script-src")):
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{rule} 'sha256-{digest}'" in policy
    names = {name for _, name, _ in page.attributes}
    assert "style" not in names
    assert not any(name.startswith("on") for name in names)
    links = [v for _, name, v in page.attributes if name in ("src", "href")]
    assert links
    assert all(link.startswith(("#", "data:")) for link in links)


def test_the_script_is_given_the_motion_and_the_sources(page, runs):
    data = json.loads(page.scripts[0][1])["runs"]
    fields = [fields_of(read_run(folder)) for folder in runs]
    assert [each["name"] for each in data] == ["rve", "cached"]
    assert [each["arrows"] for each in data] == [[], []]  # such runs keep no recipe
    for found, known in zip(data, fields, strict=True):
        motion = np.frombuffer(base64.b64decode(found["motion"]), "<i2")
        u = found["largest"] / 32767.0 * motion.reshape(known.displacement.shape)
        np.testing.assert_allclose(u, known.displacement, atol=found["largest"] / 65000.0)
        points = np.frombuffer(base64.b64decode(found["points"]), "<f4").reshape(-1, 2)
        np.testing.assert_allclose(points, known.points, rtol=1e-6)
    assert "stress source" not in [colour["name"] for colour in data[0]["colours"]]
    (source,) = [colour for colour in data[1]["colours"] if colour["name"] == "stress source"]
    codes = np.frombuffer(base64.b64decode(source["data"]), np.int8)
    np.testing.assert_array_equal(codes, fields[1].values["stress_source"].ravel())
    assert {*source["sources"]} == {"254", "3"}


@pytest.mark.parametrize(
    "shape",
    [
        Plane(normal=(0.6, -0.8)),
        Circle(radius=3.0),
        Corner(axis=(1.0, -2.0), angle=70.0, radius=2.0),
    ],
    ids=lambda shape: type(shape).__name__,
)
def test_outlines_of_bodies_are_where_their_gap_is_zero(shape):
    line = outline(shape, 50.0)
    shown = line[:2] if isinstance(shape, Plane) else line
    np.testing.assert_allclose(shape.gap(shown)[0], 0.0, atol=1e-9)
    middles = 0.5 * (line + np.roll(line, -1, axis=0))
    assert (shape.gap(middles)[0] < 1e-9).all(), "the line is around the body"


def test_bodies_are_where_they_touch_the_tissue(tmp_path):
    """In the picture for paper and for the script: a plate that presses the upper side."""
    plate = RigidBody(
        name="plate",
        shape=Plane(normal=(0.0, -1.0)),
        on="top",
        position=(0.0, 101.0),
        displacement=(0.0, -6.0),
        amplitude=Ramp(end=30.0, smooth=True),
    )
    problem = Problem(
        mesh=rectangle(100.0, 100.0, (2, 2)),
        conditions=(Fixed(on="bottom"),),
        bodies=(plate,),
        duration=30.0,
        watched={"middle": (50.0, 50.0)},
    )
    save_run(simulate(problem, KelvinVoigt()), tmp_path / "run")
    run = read_run(tmp_path / "run")
    fields = fields_of(run)
    (body,) = bodies_of(run, fields)
    last = fields.points + fields.displacement[-1]
    assert body.outline[:2, 1] == pytest.approx([101.0, 101.0])
    assert body.at(-1, 1.0)[:2, 1] == pytest.approx([95.0, 95.0])
    assert last[:, 1].max() == pytest.approx(95.0, abs=0.1)
    parts, (data,) = motion_section([(run, fields)])
    assert "".join(parts).count("<img") == 1
    np.testing.assert_allclose(data["bodies"][0]["moved"], body.moved, atol=1e-3)


def test_a_bare_run_is_shown_with_sentences_for_what_it_lacks(runs, tmp_path):
    true = runs[0]
    for name in ("fields.h5", "points.h5", "energies.csv"):
        (true / name).unlink()
    failed = replace(read_record(true), status="failed", error="it broke at t = 1 µs")
    write_record(true, failed)
    page = Page([true], tmp_path / "one.html")
    for sentence in (
        "rve: failed; it broke at t = 1 µs",
        "rve: no fields in its folder",
        "rve: no energies.csv in its folder",
        "One run, so there is nothing to compare it with",
        "no log of events",
    ):
        assert sentence in page.words


def test_runs_of_other_loads_are_shown_but_not_compared(runs, tmp_path):
    record = read_record(runs[1])
    load = deepcopy(record.recipe["conditions"])
    load["load"]["acceleration"] = [0.0, -0.4]
    write_record(runs[1], replace(record, recipe={**record.recipe, "conditions": load}))
    page = Page(runs, tmp_path / "two.html")
    assert "Not compared: " in page.words
    assert "conditions.load.acceleration" in page.words


def test_no_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match="report: no run folder; give at least one"):
        write_report([], tmp_path / "report.html")


def test_what_buckled_is_a_headline_and_a_colour(runs, tmp_path):
    """Of a run whose record and fields say so; the page of the others has neither."""
    pages = []
    for is_buckled in (False, True):
        if is_buckled:
            record = read_record(runs[0])
            beyond = {"points": 6, "of": 20, "from": 2.5}
            write_record(runs[0], replace(record, met={"beyond_bifurcation": beyond}))
        pages.append(Page(runs, tmp_path / f"{is_buckled}.html").words)
    sentence = "rve: from 2.5 µs on, 6 of 20 points left a bifurcation"
    assert sentence in pages[1]
    assert "left a bifurcation" not in pages[0]
    assert "points beyond a bifurcation" in pages[1], "in the table of the comparison"
