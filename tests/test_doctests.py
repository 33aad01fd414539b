"""Examples in docstrings: each runs by itself and prints what it says."""

import ast
import doctest
import shutil

import pytest

import surrofe2
from tests.conftest import ROOT

USED_MOST = (
    "BodyForce", "CellParameters", "Fixed", "LivingTissue", "LoadCase", "PrescribedMotion",
    "Problem", "Ramp", "RveLaw", "SamplingRange", "Sine", "StressSamples", "Table", "Traction",
    "describe", "difference", "find_rest", "follow_path", "living_cell", "load_recipe",
    "ramp_and_hold", "read_run", "rectangle", "sample", "simulate", "train", "with_boundaries",
    "with_regions",
)  # fmt: skip
"""Names from `surrofe2` that pages, examples and notebooks use most."""
PROMPT = ">>> "


def docstrings(path):
    """(line, text) of each docstring of a file that has an example."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            text = ast.get_docstring(node)
            if text and PROMPT in text:
                yield node.body[0].lineno, text


def examples():
    """Every docstring of the package with an example, as doctest has it, in a fresh namespace."""
    parser = doctest.DocTestParser()
    for path in sorted((ROOT / "surrofe2").rglob("*.py")):
        for line, text in docstrings(path):
            name = f"{path.relative_to(ROOT)}:{line}"
            yield parser.get_doctest(text, {}, name, str(path), line)


EXAMPLES = list(examples())


@pytest.mark.parametrize("name", USED_MOST)
def test_a_name_that_is_used_most_has_an_example(name):
    text = getattr(surrofe2, name).__doc__
    _, section, example = text.partition("Examples:")
    assert section
    assert any(each.want for each in doctest.DocTestParser().get_examples(example))


def test_every_prompt_stands_in_a_docstring_that_runs():
    """Elsewhere, as in a comment or a string that is not at the beginning, nothing would run it."""
    for path in sorted((ROOT / "surrofe2").rglob("*.py")):
        number = sum(text.count(PROMPT) for _, text in docstrings(path))
        assert path.read_text(encoding="utf-8").count(PROMPT) == number, path


def test_examples_print_what_they_say(tmp_path, monkeypatch):
    """In a folder with the recipes of the repository, where they may write."""
    ignored = shutil.ignore_patterns("*.h5")
    shutil.copytree(ROOT / "data", tmp_path / "data", ignore=ignored)
    monkeypatch.chdir(tmp_path)
    failures = []
    for example in EXAMPLES:
        doctest.DocTestRunner(verbose=False).run(example, out=failures.append)
    assert len(EXAMPLES) >= len(USED_MOST)
    assert not failures, "\n".join(failures)
