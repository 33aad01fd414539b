"""Recipes as editors save them: encodings, marks, and signs that look the same."""

import codecs
import time

import pytest

from surrofe2.base.errors import FileError, InputError, Surrofe2Error
from surrofe2.base.settings import build
from surrofe2.problem.conditions import Fixed
from surrofe2.recipe.entries import listed_values, read_toml, with_changes
from surrofe2.recipe.recipe import MeshSettings, load_recipe, make_recipe
from surrofe2.store.store import read_text
from tests.conftest import BAR

MICRO, GREEK = "\u00b5", "\u03bc"
TEXT = f'[cell]\npreset = "printed"\n# {MICRO}m\n{BAR}'


def test_a_byte_order_mark_is_read(tmp_path):
    for begin in (b"", codecs.BOM_UTF8):
        path = tmp_path / "bar.toml"
        path.write_bytes(begin + TEXT.replace("\n", "\r\n").encode())
        assert load_recipe(path).duration == 4.0


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_is_named(tmp_path, encoding):
    path = tmp_path / "bar.toml"
    for text in (TEXT, "\n", "[", "#:schema ./x\n"):
        path.write_text(text, encoding=encoding)
        with pytest.raises(FileError, match=r"bar\.toml: this is UTF-16 text; save it as UTF-8"):
            load_recipe(path)


@pytest.mark.parametrize("encoding", ["utf-32", "utf-32-le", "utf-32-be"])
def test_utf_32_is_named(tmp_path, encoding):
    path = tmp_path / "bar.toml"
    path.write_text(TEXT, encoding=encoding)
    with pytest.raises(FileError, match=r"bar\.toml: this is UTF-32 text; save it as UTF-8"):
        load_recipe(path)


def test_other_encodings_are_refused_by_the_line(tmp_path):
    path = tmp_path / "bar.toml"
    path.write_text(TEXT, encoding="latin-1")
    message = r"bar\.toml: not UTF-8: byte 0xb5 in line 3; save it as UTF-8"
    with pytest.raises(FileError, match=message):
        load_recipe(path)


def test_plain_text_is_taken_as_it_is(tmp_path):
    path = tmp_path / "a.txt"
    for text in ("", "a", "ab", "µ", "é\n", "叶"):
        path.write_text(text, encoding="utf-8")
        assert read_text(path) == text


def test_units_are_read_with_greek_mu():
    settings = build(MeshSettings, {"file": "a.msh", "length_unit": f"{GREEK}m"}, "mesh")
    assert settings.length_unit == f"{MICRO}m"


def test_names_are_the_same_with_greek_mu():
    assert Fixed(on=f"{GREEK}-side").on == f"{MICRO}-side"
    text = TEXT.replace('"left"', f'"{GREEK}-side"').replace("tip =", f'"{GREEK}-tip" =')
    text = f'{text}[mesh.boundaries]\n"{MICRO}-side" = {{ box = [0, 0, 0, 100] }}\n'
    recipe = make_recipe(read_toml(text))
    problem = recipe.problem()
    assert [*problem.watched] == [f"{MICRO}-tip"]
    assert problem.conditions[0].on == f"{MICRO}-side"
    assert len(problem.mesh.boundaries[f"{MICRO}-side"]) == 2


def test_cells_are_chosen_with_greek_mu():
    table = read_toml(f'{BAR}[cells."{GREEK}1"]\nregions = ["rest"]\n')
    recipe = make_recipe(table)
    assert [*recipe.cells] == [f"{MICRO}1"]
    assert [*recipe.studies(f"{GREEK}1")] == [*recipe.studies(f"{MICRO}1")] == [f"{MICRO}1"]
    changed = with_changes(table, {f"cells.{MICRO}1.wall_stiffness": 1.0})
    assert changed == with_changes(table, {f"cells.{GREEK}1.wall_stiffness": 1.0})
    assert changed["cells"][f"{MICRO}1"]["wall_stiffness"] == 1.0
    assert table["cells"][f"{GREEK}1"] == {"regions": ["rest"]}


def test_two_names_that_look_the_same_are_refused():
    text = f'{BAR}\n[bodies]\n"{GREEK}" = 1\n"{MICRO}" = 2\n'
    with pytest.raises(InputError, match=f"bodies.{MICRO}: it is there twice"):
        make_recipe(read_toml(text))


def test_names_of_files_stay_as_the_disk_has_them(tmp_path):
    table = {
        "samples": {"file": f"{GREEK}.h5"},
        "training": {"file": f"{GREEK}-t.h5"},
    }
    recipe = make_recipe(table, tmp_path / "bar.toml")
    assert recipe.study().data_path().name == f"{GREEK}.h5"
    assert recipe.study().training_path().name == f"{GREEK}-t.h5"
    settings = build(MeshSettings, {"file": f"{GREEK}.msh"}, "mesh")
    assert settings.file == f"{GREEK}.msh"


MANY = 20_000
NESTED = {
    "dotted keys": ".".join(["a"] * MANY) + " = 1\n",
    "quoted dotted keys": ".".join(['"a"'] * MANY) + " = 1\n",
    "keys with blanks": " . ".join(["a", "'b'"] * MANY) + " = 1\n",
    "a dotted table": "[" + ".".join(["a"] * MANY) + "]\nb = 1\n",
    "dotted tables in a list": "[[" + ".".join(["a"] * MANY) + "]]\nb = 1\n",
    "inline tables": "a = " + "{a = " * 300 + "1" + "}" * 300 + "\n",
    "dotted inline tables": "a = {" + ".".join(["a"] * MANY) + " = 1}\n",
    "lists": "a = " + "[" * 3000 + "]" * 3000 + "\n",
    "tables in lists": "a = " + "[{a = " * 40 + "1" + "}]" * 40 + "\n",
    "tables in turn": "".join(f"[{'.'.join(['a'] * k)}]\n" for k in range(1, 60)),
    "dotted keys in a table": f"[{'.'.join('a' * 40)}]\n{'.'.join('b' * 40)} = 1\n",
}


@pytest.mark.parametrize("text", NESTED.values(), ids=[name.replace(" ", "-") for name in NESTED])
def test_deep_nesting_is_refused_at_once(tmp_path, text):
    path = tmp_path / "bar.toml"
    for begin in ("", "[cell]\n", "[mesh]\n"):
        path.write_text(begin + text)
        before = time.perf_counter()
        with pytest.raises(InputError, match=r"bar\.toml: not TOML: tables or lists nested more"):
            load_recipe(path)
        assert time.perf_counter() - before < 1.0


def test_long_lines_take_no_time():
    for text in ("a" * 10**6, "a." * 40 + "b", '"' * 10**5, "a " * 10**6, "'" * 9999 + '"' * 9999):
        before = time.perf_counter()
        with pytest.raises(ValueError, match=r"line 1|nested|document"):
            read_toml(text)
        assert time.perf_counter() - before < 1.0


def test_deep_values_of_the_command_line_are_words():
    deep = "{" + ".".join(["a"] * 1000) + "=1}"
    assert listed_values("cell.preset", deep) == [deep]
    with pytest.raises(Surrofe2Error, match="preset"):
        make_recipe(with_changes({}, {"cell.preset": deep}))


def test_dots_in_texts_and_comments_are_no_keys():
    text = "# a" + ".a" * 30 + '\na = "1' + ".1" * 30 + '"\nb.c.d.e = 1.5\n'
    assert read_toml(text)["b"]["c"]["d"]["e"] == 1.5
