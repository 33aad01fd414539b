"""Pages and help are in plain words; CONTRIBUTING.md has the list of substitutions."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    *(ROOT / name for name in ("README.md", "data/README.md", "training/README.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "examples").glob("*.md")),
    *sorted((ROOT / "surrofe2" / "cli").glob("*.py")),  # help stands there
]
INSTEAD = {
    r"\bin the place of\b": "instead of",
    r"\banew\b": "again",
    r"\bdear(er)?\b": "expensive, more expensive",
    r"\btrue RVEs?\b": "RVE",
    r"\btrue (FE²|runs?|stress(es)?|one)\b": "full FE², full run, RVE stress",
    r"\bgoes on\b": "resumes, continues",
    r"\bmended\b": "fixed",
    r"\bis told\b": "is reported",
    r"\b(with|in|by|gives|ends) (a|one) sentence\b": "an error message",
    r"\b(cells|particles) an RVE\b": "per RVE",
    r"\b(elements|moduli|springs) a side\b": "per side",
}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_are_in_plain_words(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    text = " ".join(text.split())
    for pattern, better in INSTEAD.items():
        found = re.search(f".{{0,30}}{pattern}", text)
        assert not found, f"{found[0]!r}: write {better!r}"
