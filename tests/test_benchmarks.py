"""Figures come from one file; the benchmarks run. How fast anything is, is not asked here."""

import subprocess
import sys

import pytest

from benchmarks.__main__ import TOPICS
from benchmarks.measured import ROOT, Bench, merge, number, read
from benchmarks.pages import pages, stale, unmarked, with_figures
from benchmarks.trust import digest, picture_digest, shown


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_state_figures_as_they_were_measured(page):
    text = page.read_text(encoding="utf-8")
    assert not stale(text, read()), "run python -m benchmarks tables"
    assert not unmarked(text, read()), "name the figure: <!-- NAME -->VALUE<!-- / -->"


@pytest.fixture
def figures(tmp_path):
    bench = Bench(False, tmp_path, "python -m benchmarks made")
    bench.add("bar.speed", 5.004, "×", "a ratio")
    bench.add("bar.error", 0.0123, "%", "an error")
    bench.add("bar.solves", 16.0, "", "a count")
    bench.add("bar.lookup", 0.0912, "µs", "a time")
    return bench.figures


def test_a_marked_figure_is_written_and_a_stale_one_is_named(figures):
    old = "by <!-- bar.speed -->4.00 ×<!-- / --> and <!-- bar.solves -->16<!-- / -->, not 4.00 ×"
    assert stale(old, figures) == ["bar.speed: 4.00 × is written, 5.00 ×"]
    new = with_figures(old, figures)
    assert (
        new
        == "by <!-- bar.speed -->5.00 ×<!-- / --> and <!-- bar.solves -->16<!-- / -->, not 4.00 ×"
    )
    assert not stale(new, figures)
    assert with_figures(new, figures) == new


def test_a_figure_that_was_not_measured_is_named(figures):
    text = "<!-- bar.gone -->1 s<!-- / -->"
    assert stale(text, figures) == ["bar.gone: 1 s is written, not measured"]
    with pytest.raises(KeyError, match=r"bar\.gone"):
        with_figures(text, figures)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("faster by 5.00 ×.", ["5.00 ×"]),
        ("faster by 4.99 ×, once", ["4.99 ×"]),
        ("a lookup takes **0.091 µs**", ["0.091 µs of bar.lookup"]),
        ("10.091 µs", []),
        ("16 × 16 elements of 16 × 0.5 µm, 0.012 % of error", []),
        ("<!-- bar.speed -->5.00 ×<!-- / -->", []),
        ("```\n5.00 × was printed\n```", []),
    ],
)
def test_a_typed_figure_is_seen(figures, text, names):
    assert unmarked(text, figures) == names


def test_the_picture_of_the_trust_page_is_of_the_stored_figures():
    assert picture_digest() == digest(shown(read())), "run make accept-cache"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (208880, "208,880"), (42.31, "42.3"), (5.254, "5.25"), (0.00732, "0.0073")],
)
def test_numbers_are_for_people(value, text):
    assert number(value) == text


def test_figures_are_merged_by_name(tmp_path):
    path = tmp_path / "measured.json"
    first, second = (Bench(False, tmp_path, "python -m benchmarks made") for _ in range(2))
    first.add("bar.speed", 5.0, "×", "a ratio", at_least=4.0)
    first.add("bar.error", 0.2, "%", "an error", at_most=0.1)
    second.add("bar.speed", 6.0, "×", "a ratio", at_least=4.0)
    merge(path, first.figures)
    merge(path, second.figures)
    figures = read(path)
    assert [figures["bar.speed"].holds, figures["bar.error"].holds] == [True, False]
    assert [str(figures["bar.speed"]), str(figures["bar.error"])] == ["6.00 ×", "0.20 %"]
    assert figures["bar.speed"].command == "python -m benchmarks made"
    assert figures["bar.speed"].version
    assert figures["bar.speed"].machine


@pytest.mark.nightly
@pytest.mark.parametrize("topic", [*TOPICS, "examples", "ranks", "press"])
def test_each_topic_runs_in_quick_mode(tmp_path, topic):
    command = [sys.executable, "-m", "benchmarks", topic, "--quick", "--out", str(tmp_path)]
    before = (ROOT / "docs" / "measured.json").read_bytes()
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (ROOT / "docs" / "measured.json").read_bytes() == before
