"""Recipes that nobody would write: a problem, or one sentence that names the file."""

import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from typer.testing import CliRunner

from surrofe2.base.errors import FileError, InputError
from surrofe2.cli import app
from surrofe2.recipe.recipe import load_recipe, make_recipe
from tests.fuzz.fuzzing import EXTREME, LONGEST, answered, damaged_lines, examples, few_and_all

ROOT = Path(__file__).parents[2]
TEXTS = tuple(
    path.read_text(encoding="utf-8")
    for path in sorted([*ROOT.glob("data/*.toml"), *ROOT.glob("examples/*.toml")])
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the mesh that a shipped recipe names."""
    made = tmp_path_factory.mktemp("recipes")
    shutil.copy(ROOT / "examples" / "notched-leaf.msh", made)
    return made


def read(path):
    with np.errstate(all="warn"), answered(path.name):
        recipe = load_recipe(path)
        recipe.to_dict()
        recipe.problem()


FOUND = [
    *(f"[load]\nwidth = {value}\n" for value in EXTREME),
    *(
        f"[mesh]\nfile = {value}\n[conditions.a]\nkind = {value}\non = {value}\n"
        for value in EXTREME
    ),
]
"""Recipes of which many gave a traceback or a sentence without end."""


@few_and_all(100, 2000)
def test_damaged_text(folder, number):
    @examples(number)
    @given(damaged_lines(TEXTS))
    def check(text):
        path = folder / "recipe.toml"
        path.write_text(text, encoding="utf-8")
        read(path)

    for text in FOUND:
        check = example(text)(check)
    check()


VALUES = (
    None, True, 0, -1, 1, 10**400, 10**5000, 2**63, 10**30, 1e-320, 1e308, -1e308, 1e30, 1e-30,
    -1e30, float("inf"), float("nan"), "", "x" * 5000, "left", "..", "/dev/zero", "\0", "\n", [],
    {}, [[]], {"": {}}, [1e308, -1e308], [0.0, 0.0], [1e-320, 1e308], [1e30, -1e30], [1e-30, 1e-30],
    [1.0] * 3, [[0.0, 1.0], [0.0, 2.0]], [[0.0, 1e30], [1e-30, -1e30]],
    {"kind": "sine", "frequency": 1e308}, {"kind": "ramp", "begin": -1e30, "end": 1e30},
    {"kind": "pulse", "length": 1e-320}, {"kind": "table", "points": []},
    {"circle": {"centre": [0.0, 0.0], "radius": 1e308}},
    {"half_plane": {"through": [1e308, 0.0], "normal": [1e308, 1e308]}},
    {"half_plane": {"through": [0.0, 0.0], "normal": [1e-320, 0.0]}},
)  # fmt: skip


def places(tree, prefix=()):
    """Where entries stand in nested tables and lists."""
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in entries:
        yield (*prefix, key)
        if isinstance(value, dict | list):
            yield from places(value, (*prefix, key))


def replaced(tree, place, value):
    """A copy with another value at a place."""
    if not place:
        return value
    copied = dict(tree) if isinstance(tree, dict) else list(tree)
    copied[place[0]] = replaced(copied[place[0]], place[1:], value)
    return copied


TREES = [tomllib.loads(text) for text in TEXTS]
PLACES = [(tree, place) for tree in TREES for place in places(tree)]


@few_and_all(100, 2000)
def test_damaged_entries(folder, number):
    path = folder / "recipe.toml"

    @examples(number)
    @given(st.sampled_from(PLACES), st.sampled_from(VALUES))
    def check(at, value):
        with np.errstate(all="warn"), answered(path.name):
            recipe = made(replaced(*at, value), path)
            recipe.to_dict()
            recipe.problem()

    check()


def made(tree, path):
    """As `load_recipe` of a file."""
    try:
        return make_recipe(tree, path)
    except (FileError, InputError) as error:
        raise type(error)(f"{path.name}: {error}") from None


@few_and_all(20, 200)
def test_the_command_line_says_it_in_one_line(folder, number):
    path = folder / "recipe.toml"

    @examples(number)
    @given(damaged_lines(TEXTS))
    def check(text):
        path.write_text(text, encoding="utf-8")
        try:
            load_recipe(path).problem()
        except (FileError, InputError):
            run = ["run", str(path), "--law", "rve", "--out", str(folder / "out")]
            done = CliRunner().invoke(app, run)
            assert done.exit_code == 1
            assert isinstance(done.exception, SystemExit)
            (line,) = done.stderr.splitlines()
            assert line.startswith("error: ")
            assert path.name in line
            assert len(line) <= 7 + LONGEST

    check()


def test_a_name_that_no_file_can_have(folder):
    path = folder / "recipe.toml"
    for name in ("x" * 300, "a\\u0000b"):
        path.write_text(f'[samples]\nfile = "{name}"\n', encoding="utf-8")
        with pytest.raises(
            InputError, match=r"recipe\.toml: samples\.file: .*no file can be called so"
        ):
            load_recipe(path).study().data_path()
    done = CliRunner().invoke(app, ["compare", "x" * 300, "y" * 300, "--out", str(folder)])
    assert done.exit_code == 1
    assert "File name too long" in done.stderr
