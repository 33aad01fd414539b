"""Measured figures in README and documentation: text between two comments, which a command writes.

A page says `<!-- solve.lookup -->0.091 µs<!-- / -->`: the name of a figure of docs/measured.json
and its value. So the page shows numbers wherever it is read, and `python -m benchmarks tables`
writes them again. Benchmarks do so after they have measured.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from benchmarks.measured import ROOT, Figure, read

MARKED = re.compile(r"<!-- (\w+(?:\.\w+)+) -->(.*?)<!-- / -->")
RATIO = re.compile(r"(?<![\d.])\d+\.\d+ ×")
TIMED = ("s", "min", "µs", "GB")
FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def pages() -> list[Path]:
    """All pages that may state figures of docs/measured.json."""
    return [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        ROOT / "data" / "README.md",
        ROOT / "training" / "README.md",
        *sorted((ROOT / "docs").rglob("*.md")),
        *sorted((ROOT / "examples").glob("*.md")),
    ]


def with_figures(text: str, figures: Mapping[str, Figure]) -> str:
    """A page's text with every marked figure as measured.

    Raises:
        KeyError: a figure that was not measured.
    """
    return MARKED.sub(lambda mark: f"<!-- {mark[1]} -->{figures[mark[1]]}<!-- / -->", text)


def stale(text: str, figures: Mapping[str, Figure]) -> list[str]:
    """Marked figures of a page that are not as measured, each with what is written and measured."""
    parts = []
    for name, written in MARKED.findall(text):
        measured = str(figures[name]) if name in figures else "not measured"
        if written != measured:
            parts.append(f"{name}: {written} is written, {measured}")
    return parts


def unmarked(text: str, figures: Mapping[str, Figure]) -> list[str]:
    """Times, memory and ratios of speed that a page states without their names, code left out.

    Seen are all ratios with a decimal point, as in "5.01 ×", and every measured time and memory.
    Errors in per cent are not looked for: other studies have some with the same two digits.
    """
    words = MARKED.sub("", FENCED.sub("", text))
    parts = RATIO.findall(words)
    for name, figure in figures.items():
        value = re.escape(str(figure))
        if figure.unit in TIMED and re.search(rf"(?<![\d.]){value}(?!\w)", words):
            parts.append(f"{figure} of {name}")
    return parts


def write_figures() -> None:
    """Write the stored figures into every page that names them."""
    figures = read()
    for page in pages():
        text = page.read_text(encoding="utf-8")
        written = with_figures(text, figures)
        if written != text:
            page.write_text(written, encoding="utf-8")
