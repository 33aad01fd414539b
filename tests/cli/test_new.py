"""`new` and `export`: recipes that load, run and explain their keys; what is there stays."""

import re

import pytest

from surrofe2.recipe.recipe import load_recipe
from surrofe2.recipe.schema import SCHEMA, TEMPLATES, write_recipe
from surrofe2.store.run_folder import read_record
from surrofe2.store.surrogates import write_surrogate
from tests.conftest import ROOT
from tests.laws import SquareLaw
from tests.surrogate.twins import make_law


@pytest.mark.parametrize("kind", TEMPLATES)
def test_each_kind_loads_and_runs_some_steps(invoke, tmp_path, kind):
    path = tmp_path / "mine.toml"
    done = invoke("new", path, "--example", kind)
    assert done.stdout.startswith(f"{path}: recipe of {TEMPLATES[kind]}")
    recipe = load_recipe(path)
    for part in recipe.studies().values():
        assert part.data_path().parent == part.training_path().parent == tmp_path
        assert part.data_path().stem.startswith("mine")
        assert part.cell.range is not None
    of = "load" if recipe.is_bar else "time"
    text = path.read_text(encoding="utf-8")
    long = re.search(rf"(?ms)^\[{of}\].*?^(duration = \S+)", text)[1]
    path.write_text(text.replace(long, "duration = 2.0"), encoding="utf-8")
    out = tmp_path / "out"
    invoke("run", path, "--law", "rve", "--out", out, law=SquareLaw)
    assert read_record(out).counts["steps"] > 2


@pytest.mark.parametrize("kind", TEMPLATES)
def test_what_is_a_comment_is_a_default(tmp_path, kind):
    path = tmp_path / "mine.toml"
    write_recipe(path, kind)
    text = path.read_text(encoding="utf-8")
    assert max(map(len, text.splitlines())) <= 100
    before = load_recipe(path).to_dict()
    stated = re.sub(r"(?m)^# (\w+ = )", r"\1", text)
    assert kind == "cells" or stated != text
    path.write_text(stated, encoding="utf-8")
    assert load_recipe(path).to_dict() == before


def test_the_bar_is_that_of_the_clone(tmp_path):
    path = tmp_path / "bending-bar.toml"
    write_recipe(path, "bar")
    here = load_recipe(path).to_dict()
    there = load_recipe(ROOT / "data" / "bending-bar.toml").to_dict()
    here["training"]["file"] = there["training"]["file"]
    assert here == there


def test_what_is_there_is_not_written_over(invoke, tmp_path):
    path = tmp_path / "mine.toml"
    invoke("new", path, "--example", "strip")
    invoke("new", tmp_path / "mine", "--example", "strip")
    refused = invoke("new", path, "--example", "bar", code=1)
    told = "another file is there; --fresh writes this one in its place"
    assert refused.stderr == f"error: {path}: {told}\n"
    assert "pulled" in path.read_text(encoding="utf-8")
    invoke("new", path, "--example", "bar", "--fresh")


def test_kinds_are_told(invoke, tmp_path):
    refused = invoke("new", tmp_path / "a", "--example", "bra", code=1)
    assert refused.stderr.startswith("error: --example: 'bra': unknown kind; did you mean bar?")


@pytest.fixture
def surrogate(tmp_path):
    write_surrogate(make_law(), tmp_path / "law-surrogate.h5")
    return tmp_path / "law-surrogate.h5"


def test_the_source_lies_beside_the_surrogate(surrogate, invoke):
    done = invoke("export", surrogate, "--to", "c")
    source = surrogate.with_suffix(".c")
    lines = source.read_text(encoding="utf-8").count("\n")
    assert f"{source}: {lines} lines of C, " in done.output


def test_a_source_that_is_there_stays(surrogate, invoke):
    source = surrogate.with_suffix(".c")
    invoke("export", surrogate, "--name", "other")
    whole = source.read_bytes()
    done = invoke("export", surrogate, code=1)
    assert "another source is there; --fresh" in done.output
    assert source.read_bytes() == whole
    invoke("export", surrogate, "--fresh")
    invoke("export", surrogate)  # the same, so nothing is lost
    assert b"int surrofe2_stress(" in source.read_bytes()


@pytest.mark.parametrize("ending", [".c", ".h", ".toml"])
@pytest.mark.parametrize("fresh", [(), ("--fresh",)])
def test_a_file_that_export_did_not_write_stays(surrogate, invoke, tmp_path, ending, fresh):
    mine = tmp_path / f"mine{ending}"
    mine.write_text("int main;\n", encoding="utf-8")
    out = mine.with_suffix(".c") if ending == ".h" else mine
    done = invoke("export", surrogate, "--out", out, *fresh, code=1)
    assert f"{mine}: not a C source of a surrogate, so --fresh does not replace it" in done.stderr
    assert mine.read_text(encoding="utf-8") == "int main;\n"
    assert [each.name for each in tmp_path.glob("mine.*")] == [mine.name]


def test_a_source_is_no_header(surrogate, invoke, tmp_path):
    done = invoke("export", surrogate, "--out", tmp_path / "a.h", code=1)
    assert "the header goes there; give the source another ending, .c" in done.stderr


@pytest.mark.parametrize("name", ["mine.toml", "mine.msh", SCHEMA])
@pytest.mark.parametrize("fresh", [(), ("--fresh",)])
def test_a_file_that_new_did_not_write_stays(invoke, tmp_path, name, fresh):
    mine = tmp_path / name
    mine.write_text("something else\n", encoding="utf-8")
    path = tmp_path / "mine.toml"
    done = invoke("new", path, "--example", "mesh", *fresh, code=1)
    assert f"{mine}: not a " in done.stderr
    assert "so --fresh does not replace it" in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == [name]
    assert mine.read_text(encoding="utf-8") == "something else\n"


def test_a_name_may_have_quotes(tmp_path):
    path = tmp_path / 'a"b\\.toml'
    write_recipe(path, "bar")
    assert load_recipe(path).study().data_path() == tmp_path / 'a"b\\.h5'
