"""Names of files and texts of recipes may hold anything; a terminal obeys none of it."""

import io
import os
import re
import shlex
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from rich.console import Console
from rich.progress import Progress

from surrofe2.base.errors import InputError, printable
from surrofe2.cli import console as shown
from surrofe2.report.tables import Quantity, Table
from tests.cli.conftest import call

HOSTILE = {
    "title": "\x1b]0;mine\x07",
    "title ended by ST": "\x1b]2;mine\x1b\\",
    "clear the screen": "\x1b[2J\x1b[H",
    "clear the history": "\x1b[3J",
    "cursor up": "\x1b[5A",
    "cursor home": "\x1b[1;1H",
    "erase the line": "\x1b[2K",
    "colour": "\x1b[31mred",
    "hidden": "\x1b[8mhidden",
    "link": "\x1b]8;;http://example.org\x1b\\word\x1b]8;;\x1b\\",
    "clipboard": "\x1b]52;c;aGVsbG8=\x07",
    "answer back": "\x05",
    "report of the cursor": "\x1b[6n",
    "report of the title": "\x1b[21t",
    "reset": "\x1bc",
    "another screen": "\x1b[?1049h",
    "no cursor": "\x1b[?25l",
    "other signs": "\x1b(0",
    "device control": "\x1bPq\x1b\\",
    "CSI in one byte": "\x9b2J",
    "OSC in one byte": "\x9d0;mine\x9c",
    "back to the beginning": "all is\rwell",
    "backspace": "abc\x08\x08\x08xyz",
    "bell": "\x07",
    "line break": "one\nerror: two",
    "vertical tab": "\x0b\x0c",
    "shift out": "\x0e",
    "delete": "\x7f",
    "next line": "\x85",
    "right to left": "\u202egnp.exe",
    "isolate": "\u2066a\u2069",
    "invisible": "a\u200bb\u2060c\ufeff",
    "soft hyphen": "a\xadb",
    "line separator": "a\u2028b",
    "tags": "\U000e0041",
    "no UTF-8": "caf\udce9",
    "lone surrogate": "\ud83d",
}
"""Texts that change or deceive a terminal which gets them as they are."""
RAW = re.compile(r"[^\n -~\xa1-\xac\xae-\u02ff\u2010-\u2027\u2190-\u25ff…]")
"""Anything but a line break and visible signs that the tests print."""
BRACKETS = ("bar[rve]", "bar[bold]", "[/rve]", "a[link=x]b[/link]", ":smile:", "[red", "\\[a]")


NO_ARGUMENT = "lone surrogate"
"""What no argument and no name of a file can be."""


@pytest.fixture(params=HOSTILE, ids=lambda name: name.replace(" ", "-"))
def hostile(request):
    return HOSTILE[request.param]


ARGUMENTS = [name for name in HOSTILE if name != NO_ARGUMENT]


@pytest.fixture(params=ARGUMENTS, ids=lambda name: name.replace(" ", "-"))
def hostile_argument(request):
    return HOSTILE[request.param]


def assert_plain(text):
    assert not (found := RAW.findall(text)), found


def test_everything_unprintable_has_an_escape(hostile):
    escaped = printable(f"a {hostile} b")
    assert escaped.isprintable()
    assert "\\" in escaped
    assert_plain(escaped)


def test_what_can_be_seen_stays_as_it_is():
    for text in ("", "out/bar [1]", "µN/µm", "café", "叶", "Ḟ = 0", "C:\\new", "😀"):
        assert printable(text) == text


def test_no_line_table_or_warning_passes_it_on(hostile, capsys):
    shown.begin("compare", quiet=False)
    shown.print_line(f"{hostile}: done")
    shown.print_warning(f"error: {hostile}")
    shown.done(f"out/{hostile}", hostile)
    rows = [{"run": hostile, hostile: 1.0}]
    quantities = [Quantity("run", "", ""), Quantity(hostile, hostile, ".3g")]
    shown.show_table(f"Against {hostile}", Table(quantities, rows))
    for text in capsys.readouterr():
        assert_plain(text)
    assert "error: two" not in capsys.readouterr().out


def test_no_progress_passes_it_on(hostile, monkeypatch, capsys):
    seconds = [0.0]
    monkeypatch.setattr(shown.time, "perf_counter", lambda: seconds[0])
    monkeypatch.setattr(shown, "Progress", partial(Progress, refresh_per_second=100))
    shown.begin("generate", quiet=False)
    for terminal in (False, True):
        text = io.StringIO()
        made = Console(file=text, force_terminal=True, width=300, color_system=None)
        if terminal:
            monkeypatch.setattr(shown, "Console", lambda made=made, **_: made)
        with shown.progress(f"run {hostile}", 10, "samples") as report:
            for k in range(5):
                seconds[0] += 11.0
                report(k, f"point {hostile}")
                time.sleep(0.03 if terminal else 0.0)  # until it is drawn
        bars = re.sub(r"\x1b\[(\d*[AK]|2K|\?25[hl]|[\d;]*m)|\r", "", text.getvalue())
        assert_plain(bars)
        lines = capsys.readouterr().err
        assert_plain(lines)
        assert "point" in bars + lines


PRINTS = """
import sys, warnings
from surrofe2 import cli
from surrofe2.cli import console
def work():
    for text in sys.argv[1:]:
        print(text)
        warnings.warn(text)
        console.print_line(text)
        console.print_warning(text)
    raise ValueError("".join(sys.argv[1:]))
cli.app = work
cli.main()
"""


def test_no_traceback_and_no_library_passes_it_on():
    texts = [HOSTILE[name] for name in ARGUMENTS]
    words = [sys.executable, "-c", PRINTS, *texts]
    done = subprocess.run(words, capture_output=True, check=False)
    assert done.returncode == 1
    assert b"ValueError" in done.stderr
    for stream in (done.stdout, done.stderr):
        assert stream.count(b"mine") >= 6
        assert_plain(stream.decode())


@pytest.mark.parametrize("place", ["command", "option", "argument", "value"])
def test_no_error_of_usage_passes_it_on(hostile, place):
    words = {
        "command": [f"x{hostile}"],
        "option": ["check", f"--{hostile}"],
        "argument": ["check", "a.toml", f"b{hostile}"],
        "value": ["check", "a.toml", "--seconds", f"x{hostile}"],
    }[place]
    done = call(*words, code=2, env={"COLUMNS": "300"})
    assert_plain(done.stderr)


def test_no_file_passes_it_on(hostile, tmp_path):
    path = tmp_path / "recipe.toml"
    quoted = "".join(f"\\U{ord(sign):08x}" for sign in hostile.encode("utf-8", "replace").decode())
    path.write_text(f'[cell]\npreset = "{quoted}"\n[mesh]\n"{quoted}" = 1\n', encoding="utf-8")
    for words in (["check", path], ["run", path, "--law", "rve", "--out", tmp_path / "out"]):
        assert_plain(call(*words, code=1).stderr)
    if hostile != HOSTILE[NO_ARGUMENT] and "/" not in hostile:
        path = tmp_path / f"{hostile}.toml"
        path.write_text("[cel]\n", encoding="utf-8")
        assert_plain(call("check", path, code=1).stderr)


def test_colours_of_our_own_reach_a_terminal():
    done = subprocess.run(
        [sys.executable, "-c", PRINTS, "\x1b[2Jx"],
        capture_output=True,
        check=False,
        env=os.environ | {"FORCE_COLOR": "1"},
    )
    assert b"\x1b[31m\\x1b[2Jx\x1b[0m\n" in done.stderr


@pytest.mark.parametrize("name", BRACKETS)
def test_brackets_and_colons_are_no_markup(name, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "200")
    shown.begin("compare", quiet=False)
    quantities = [Quantity("run", "", ""), Quantity(name, "", ".3g")]
    shown.show_table(f"Against {name}", Table(quantities, [{"run": name, name: 1.0}]))
    shown.print_line(name)
    shown.print_warning(name)
    printed = capsys.readouterr()
    assert printed.out.count(name) == 4
    assert printed.err == f"{name}\n"
    text = io.StringIO()
    terminal = Console(file=text, force_terminal=True, width=200, color_system=None)
    monkeypatch.setattr(shown, "Console", lambda **_: terminal)
    monkeypatch.setattr(shown, "Progress", partial(Progress, refresh_per_second=100))
    with shown.progress(f"run {name}", 10, "samples") as report:
        report(3, f"point {name}")
        time.sleep(0.03)  # until it is drawn
    assert f"run {name}" in text.getvalue()
    assert f"point {name}" in text.getvalue()


@pytest.mark.parametrize("width", [40, 80])
def test_tables_of_wide_signs_fit_their_names(width, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(width))
    shown.begin("compare", quiet=False)
    quantities = [Quantity("run", "", ""), Quantity("steps", "", "")]
    shown.show_table("Against", Table(quantities, [{"run": "叶片细胞", "steps": 3}]))
    assert "叶片细胞" in capsys.readouterr().out


@pytest.mark.skipif(not Path("/bin/bash").exists(), reason="needs bash")
def test_a_shell_takes_the_command_that_resumes(hostile_argument):
    words = ["run", f"a {hostile_argument}'\\", "plain", "two  blanks"]
    line = shown.command_line(words)
    assert_plain(line)
    shell = ["bash", "-c", line.replace("surrofe2", "printf '%s\\0'", 1)]
    done = subprocess.run(shell, capture_output=True, check=True, env={"LC_ALL": "C.UTF-8"})
    assert done.stdout.split(b"\0")[:-1] == [*map(os.fsencode, words)]


def test_a_plain_command_is_quoted_as_usual():
    words = ["run", "bar [1].toml", "--law", "rve"]
    assert shown.command_line(words) == f"surrofe2 {shlex.join(words)}"


def test_an_error_keeps_the_blanks_of_a_name(capsys):
    shown.print_warning(str(InputError("a  b.toml: x\n   in the next line\n")))
    assert capsys.readouterr().err == "a  b.toml: x in the next line\n"
