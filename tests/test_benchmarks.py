"""Figures come from one file; the benchmarks run. How fast anything is, is not asked here."""

import re
import subprocess
import sys

import pytest

from benchmarks.measured import (
    ROOT,
    TABLES,
    Bench,
    merge,
    number,
    read,
    substitutions,
    table_of,
)
from benchmarks.trust import digest, picture_digest, shown


@pytest.mark.parametrize("page", TABLES)
def test_tables_have_the_measured_figures(page):
    assert table_of(page) == "\n".join(TABLES[page]()), "run python -m benchmarks tables"


def test_pages_name_figures_that_were_measured_and_type_none():
    known = read()
    ratios = {str(figure) for figure in known.values() if figure.unit == "×"}
    ratios = {text for text in ratios if "." in text}  # "16 ×" may be of 16 × 16 elements
    named = set()
    for page in sorted((ROOT / "docs").rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        named.update(re.findall(r"\{\{ ([\w.]+) \}\}", text))
        assert not [each for each in ratios if f" {each}" in text], page
    assert named
    assert not named - set(known)


def test_the_picture_of_the_trust_page_is_of_the_stored_figures():
    assert picture_digest() == digest(shown(read())), "run make accept-cache"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (208880, "208,880"), (42.31, "42.3"), (5.254, "5.25"), (0.00732, "0.0073")],
)
def test_numbers_are_for_people(value, text):
    assert number(value) == text


def test_figures_are_merged_and_told_by_name(tmp_path):
    path = tmp_path / "measured.json"
    first, second = (Bench(False, tmp_path, "python -m benchmarks made") for _ in range(2))
    first.add("bar.speed", 5.0, "×", "a ratio", at_least=4.0)
    first.add("bar.error", 0.2, "%", "an error", at_most=0.1)
    second.add("bar.speed", 6.0, "×", "a ratio", at_least=4.0)
    merge(path, first.figures)
    merge(path, second.figures)
    figures = read(path)
    assert [figures["bar.speed"].holds, figures["bar.error"].holds] == [True, False]
    assert substitutions(path) == {"bar": {"speed": "6.00 ×", "error": "0.20 %"}}
    assert figures["bar.speed"].command == "python -m benchmarks made"
    assert figures["bar.speed"].version
    assert figures["bar.speed"].machine


@pytest.mark.nightly
@pytest.mark.parametrize("topic", ["runs", "large", "solve", "tissue", "start", "trust", "ranks"])
def test_each_topic_runs_in_quick_mode(tmp_path, topic):
    command = [sys.executable, "-m", "benchmarks", topic, "--quick", "--out", str(tmp_path)]
    before = (ROOT / "docs" / "measured.json").read_bytes()
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (ROOT / "docs" / "measured.json").read_bytes() == before
