"""What a process imports, and what a command says by its exit code."""

import shlex
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from tests.processes import python

COMMAND = """
from surrofe2.cli import main
try:
    main()
except SystemExit as end:
    assert not end.code
"""
READING = ("surrofe2.cli.run", "surrofe2.cli.compare", "surrofe2.cache.cached_law",
           "surrofe2.store.surrogates")  # fmt: skip


def imported(code, heavy, *words):
    """The heavy libraries that a process has imported after some code."""
    told = (
        f"import sys; print('heavy:', *[name for name in {heavy.split()} if name in sys.modules])"
    )
    return python("-c", f"{code}\n{told}", *words).stdout.splitlines()[-1]


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        (COMMAND, "torch numba skfem numpy scipy h5py matplotlib pydantic"),
        ("import surrofe2", "torch sklearn skfem scipy.sparse meshio"),
        (f"import {', '.join(READING)}", "torch sklearn scipy.stats scipy.spatial"),
        ("import surrofe2.cli.compare", "torch numba skfem"),
        ("import surrofe2.problem.mesh", "meshio"),
    ],
    ids=["help", "the package", "runs, tables and comparisons", "comparisons", "meshes"],
)
def test_a_fresh_process_imports_nothing_heavy(code, heavy):
    assert imported(code, heavy, "--help") == "heavy:"


@pytest.mark.usefixtures("trained")
def test_a_cached_run_imports_what_it_uses(changed_recipe, tmp_path):
    """Where all its answers are in range."""
    recipe = changed_recipe("duration = 4.0", "duration = 0.5")
    words = "run", recipe, "--law", "cached", "--tolerance", "inf", "--out", tmp_path / "run"
    idle = "torch sklearn pydantic scipy.stats matplotlib surrofe2.tissue.dynamics"
    assert imported(COMMAND, idle, *words) == "heavy:"


@pytest.mark.parametrize("command", ["moduli", "check"])
def test_commands_that_draw_nothing_import_no_matplotlib(command, recipe_path):
    words = ("moduli", "--cell", "printed") if command == "moduli" else ("check", recipe_path)
    assert imported(COMMAND, "matplotlib", *words) == "heavy:"


WITHOUT_TORCH = """
import importlib.metadata, importlib.machinery
known, found = importlib.metadata.version, importlib.machinery.PathFinder.find_spec
def find_spec(name, *rest):
    return None if name == "torch" else found(name, *rest)
importlib.machinery.PathFinder.find_spec = find_spec
def version(name):
    if name == "torch":
        raise importlib.metadata.PackageNotFoundError(name)
    return known(name)
importlib.metadata.version = version
from surrofe2.cli import main
main()
"""


def test_without_torch_runs_go_on_and_training_says_what_it_needs(changed_recipe, tmp_path):
    # so short a run moves so little that a larger tolerance would be remarked upon
    small = "elements = [2, 2]\nabsolute_tolerance = 1e-9"
    recipe = changed_recipe("duration = 4.0", "duration = 0.1", "elements = [2, 2]", small)

    command = partial(python, "-c", WITHOUT_TORCH)
    assert command("run", recipe, "--law", "rve", "--out", tmp_path / "run").stderr == ""
    for name in ("check", "study"):
        command(name, "--help")
    told = "error: training needs PyTorch, which is not installed: pip install torch\n"
    assert command("train", recipe, code=1).stderr == told


@pytest.mark.parametrize(
    ("arguments", "code", "told"),
    [
        (["run"], 2, "Missing argument"),
        (["check", "none.toml"], 1, "none.toml"),
    ],
)
def test_the_exit_code_is_that_of_the_command(arguments, code, told):
    done = python("-m", "surrofe2", *arguments, code=code)
    assert told in done.stdout + done.stderr


FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
@pytest.mark.parametrize("argument", ["--version", "--help"])
def test_output_that_cannot_be_written_is_no_success(argument):
    with FULL.open("w") as full:
        command = [sys.executable, "-m", "surrofe2", argument]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "error: stdout: No space left on device\n"


WORK = """
import sys
from surrofe2 import cli
def work():
    for k in range(3):
        print("going on", file=sys.stderr, flush=True)
    open(sys.argv[1], "w").write("done")
cli.app = work
cli.main()
"""


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
@pytest.mark.parametrize("ending", ["2> /dev/full", "2>&1 | true"])
def test_work_goes_on_where_nobody_hears_of_it(tmp_path, ending):
    words = [sys.executable, "-c", WORK, str(tmp_path / "a.txt")]
    command = f"{shlex.join(words)} {ending}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert done.stdout + done.stderr == ""
    assert (tmp_path / "a.txt").read_text() == "done"
    assert done.returncode == (1 if "full" in ending else 0)


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-", ">&- 2>&- <&-"])
@pytest.mark.parametrize("arguments", ["--version", "check none.toml", "bogus"])
def test_closed_streams_are_no_traceback(closed, arguments, tmp_path):
    command = f"{shlex.quote(sys.executable)} -m surrofe2 {arguments} {closed}"
    done = subprocess.run(
        ["sh", "-c", command], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert "Traceback" not in done.stderr
    loses = closed.startswith(">") and arguments == "--version"
    wanted = {"--version": 1 if loses else 0, "check none.toml": 1, "bogus": 2}[arguments]
    assert done.returncode == wanted
    if loses and "2" not in closed:
        assert done.stderr == "error: stdout: closed before the command began\n"
