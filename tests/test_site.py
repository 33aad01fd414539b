"""The documentation site: it builds without a warning, and what it shows is complete and fresh."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import surrofe2

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


def module_of(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # its dataclasses look there
    spec.loader.exec_module(module)
    return module


record = module_of(DOCS / "record.py")


@pytest.mark.slow
def test_it_builds_without_a_warning(tmp_path):
    """-W makes a page that is not as recorded an error, too."""
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-c", "docs"]
    done = subprocess.run(
        [*build, "-d", str(tmp_path / "trees"), ".", str(tmp_path / "site")],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    theory = (tmp_path / "site/docs/theory.html").read_text(encoding="utf-8")
    text = (DOCS / "theory.md").read_text(encoding="utf-8")
    for number in {"1", "57b", "66", *re.findall(r"\((A\d+)\)", text)}:  # as the paper has them
        assert f'id="equation-{number.lower()}"' in theory
    assert 'href="#equation-a7"' in theory
    assert (tmp_path / "site/_static/mathjax/tex-chtml.js").stat().st_size > 1e6
    for page in (tmp_path / "site/docs").rglob("*.html"):
        loaded = re.findall(r'(?:src|href)="(https?://[^"]+\.(?:js|css))"', page.read_text("utf-8"))
        assert not loaded, page  # it works offline


def test_every_public_name_is_on_one_page_of_the_reference():
    pages = [page.read_text(encoding="utf-8") for page in (DOCS / "reference/api").glob("*.md")]
    told = re.findall(r"^\.\. auto(?:class|function):: (\w+)", "\n".join(pages), re.MULTILINE)
    assert sorted(told) == sorted(surrofe2.__all__)


def test_every_example_is_in_the_gallery():
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    linked = set(re.findall(r":link: \.\./examples/(\S+)", text))
    assert linked == {page.stem for page in (ROOT / "examples").glob("*.md")} - {"README"}


@pytest.mark.parametrize("book", record.notebooks(), ids=lambda path: path.stem)
def test_notebooks_show_what_their_code_printed(book):
    read = json.loads(book.read_text(encoding="utf-8"))
    assert read["metadata"]["digest"] == record.digest_of_notebook(read["cells"]), (
        f"python docs/record.py {book.name}"
    )
    assert any(cell.get("outputs") for cell in read["cells"])


def words(text: str) -> list[str]:
    """First words of lines that begin at the margin, without the figures: those are the machine's,
    and so are widths of tables and sentences on what pays.
    """
    lines = [line for line in text.splitlines() if line[:1].strip()]
    return [re.sub(r"[\d.,e+−-]+", "#", line.split()[0]) for line in lines]


@pytest.mark.slow
@pytest.mark.parametrize("page", record.pages(), ids=lambda path: path.stem)
def test_commands_print_what_pages_say(page, tmp_path):
    kept = json.loads(record.store_of(page).read_text(encoding="utf-8"))["said"]
    now = record.record(page, tmp_path)
    assert {code: words(said) for code, said in now.items()} == {
        code: words(said) for code, said in kept.items()
    }
