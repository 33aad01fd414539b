"""A run by several MPI ranks is the run by one to 1e-9 of each amplitude, resumed or not."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from surrofe2.store.run_folder import read_record
from surrofe2.workflow.run import run_study
from tests.conftest import RECIPE, ROOT
from tests.folders import assert_equal, numbers
from tests.on_ranks import recipe_of
from tests.test_going_on import home, interrupted  # noqa: F401 - a fixture

MPIEXEC = Path(sys.executable).with_name("mpiexec")
FAST = ("rve", "cached on many")
LONG = (
    "rve implicit",
    "cached",
    "surrogate",
    "slow-manifold",
    "iterated",
    "cached implicit",
    "table",
    "cells by rve",
)
OF_RANKS = ("ranks", "threads")


def on_ranks(ranks, *arguments, module="tests.on_ranks", **settings):
    return subprocess.Popen(
        [MPIEXEC, "-n", str(ranks), sys.executable, "-m", module, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **settings,
    )


def done(process):
    out, error = process.communicate(timeout=300)
    assert process.returncode == 0, error
    return out


def results(folder):
    found = numbers(folder)
    for name in OF_RANKS:
        del found["run.json"][name]
    return found


def assert_same(folder, whole):
    assert_equal(results(folder), results(whole))


@pytest.fixture(scope="module")
def by_one(home, tmp_path_factory):  # noqa: F811
    """by_one(case): the folder of the run by this process alone."""
    folder = tmp_path_factory.mktemp("one")

    def run(name):
        run_study(*recipe_of(home, name), folder / name)
        return folder / name

    return run


@pytest.fixture(scope="module")
def by_two(home, tmp_path_factory):  # noqa: F811
    """The folder of runs by two ranks."""
    folder = tmp_path_factory.mktemp("two")
    done(on_ranks(2, home, folder, *FAST))
    return folder


@pytest.mark.parametrize("name", FAST)
def test_two_ranks_leave_what_one_leaves(name, by_one, by_two):
    assert_same(by_two / name, by_one(name))
    ranks = read_record(by_two / name).ranks
    assert ranks["ranks"] == 2
    assert ranks["tasks"] > 0


def test_the_cached_run_has_hits_fallbacks_and_audits(by_two):
    record = read_record(by_two / "cached on many")
    assert record.counts["hits"] > 100
    assert record.counts["fallbacks"] > 100
    assert record.cache["audit"]["audited"] > 5


def test_a_run_resumes_on_as_many_ranks_to_the_bit(by_two, home, tmp_path):  # noqa: F811
    """Interrupted four times within steps; by RVEs, and by a cache that audits."""
    done(on_ranks(2, home, tmp_path, *(f"{how}:{name}" for name in FAST for how in ("cut", "go"))))
    for name in FAST:
        assert_equal(results(tmp_path / name), results(by_two / name), exact=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
@pytest.mark.parametrize("ranks", [2, 3])
def test_all_kinds_of_runs_are_the_same_by_several_ranks(name, ranks, by_one, home, tmp_path):  # noqa: F811
    done(on_ranks(ranks, home, tmp_path, name))
    assert_same(tmp_path / name, by_one(name))


@pytest.mark.slow
def test_a_run_goes_on_with_another_number_of_ranks(by_one, home, tmp_path):  # noqa: F811
    done(on_ranks(2, home, tmp_path, "stop:cached"))
    assert read_record(tmp_path / "cached").status == "interrupted"
    recipe, law = recipe_of(home, "cached")
    run_study(recipe, law, tmp_path / "cached")
    assert_same(tmp_path / "cached", by_one("cached"))
    interrupted(recipe, law, tmp_path / "again" / "cached", 4)
    done(on_ranks(3, home, tmp_path / "again", "go:cached"))
    assert_same(tmp_path / "again" / "cached", by_one("cached"))


@pytest.fixture
def long_run(tmp_path):
    """The arguments of a command that takes longer than any test."""
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE.replace("duration = 4.0", "duration = 1e5") + "frames = 2\n")
    return ["run", path, "--law", "rve", "--out", tmp_path / "out"]


def begun(process, folder):
    """Wait until a run has reached its first output beyond the start; the pids of its ranks."""
    until = time.monotonic() + 120.0
    while time.monotonic() < until:
        assert process.poll() is None, process.communicate()[1]
        if (folder / "checkpoint.h5").exists():
            return ranks_of(folder)
        time.sleep(0.05)
    pytest.fail("no checkpoint")


def ranks_of(folder):
    """Process numbers by rank of the command that writes into a folder."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            words = (path / "cmdline").read_bytes().split(b"\0")
            entries = (path / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        rank = [entry[9:] for entry in entries if entry.startswith(b"PMI_RANK=")]
        if str(folder).encode() in words and b"surrofe2" in words and rank:
            found[int(rank[0])] = int(path.name)
    return found


@pytest.mark.slow
def test_a_rank_that_dies_ends_the_run_with_a_sentence_and_a_checkpoint(long_run, tmp_path):
    process = on_ranks(2, *long_run, module="surrofe2")
    os.kill(begun(process, tmp_path / "out")[1], signal.SIGKILL)
    _, said = process.communicate(timeout=60)
    assert process.returncode != 0
    told = next(line for line in said.splitlines() if line.startswith("error: a rank died"))
    assert f"{tmp_path / 'out'} keeps the run" in told
    assert "any number of ranks resumes with: surrofe2 run" in told
    assert "Traceback" not in said
    record = read_record(tmp_path / "out")
    assert record.status == "running"
    interrupt_later(long_run, tmp_path / "out")


def interrupt_later(arguments, folder):
    """The command goes on from the checkpoint, and Ctrl-C ends it with a sentence."""
    stamp = (folder / "checkpoint.h5").stat().st_mtime_ns
    process = on_ranks(3, *arguments, module="surrofe2")
    until = time.monotonic() + 120.0
    while (folder / "checkpoint.h5").stat().st_mtime_ns == stamp and time.monotonic() < until:
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert f"interrupted: {folder} keeps the run" in said
    assert "Traceback" not in said
    assert read_record(folder).status == "interrupted"


def test_only_rank_0_speaks(tmp_path):
    process = on_ranks(3, "run", "none.toml", "--law", "rve", "--out", tmp_path, module="surrofe2")
    out, said = process.communicate(timeout=60)
    assert process.returncode == 1
    assert (out + said).split("\n") == [
        "error: none.toml: cannot be read: No such file or directory",
        "",
    ]


@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_points_may_be_taken_and_put_and_an_error_names_its_rank(ranks):
    said = done(on_ranks(ranks, module="tests.law_on_ranks"))
    assert said.strip() == f"rank 1 of {ranks} gave up: MemoryError: no room"


FAILED = "error: rank 1 of 2 gave up outside a task: "


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("raise", f"{FAILED}AttributeError: no such function"),
        ("exit", f"{FAILED}SystemExit: 0"),
        ("exit in a task", "rank 1 of 2 gave up: SystemExit: 0"),
        ("another version", "error: mpiexec: ranks cannot be compared (AttributeError: "),
    ],
)
def test_a_rank_that_fails_anywhere_ends_all(how, message):
    process = on_ranks(2, how, module="tests.failing_ranks")
    _, printed = process.communicate(timeout=60)
    assert process.returncode != 0
    assert message in printed


def test_a_second_signal_ends_ranks_that_wait_for_one_another():
    process = on_ranks(2, "hang", module="tests.failing_ranks")
    driver = int(process.stdout.readline())
    for _ in range(2):
        time.sleep(1.5)
        os.kill(driver, signal.SIGTERM)
    _, printed = process.communicate(timeout=20)
    assert process.returncode != 0
    assert "ended at once; files are whole" in printed


def test_a_signal_to_any_rank_interrupts_the_first():
    process = on_ranks(2, "wait", module="tests.failing_ranks")
    process.stdout.readline()
    os.kill(int(process.stdout.readline()), signal.SIGTERM)
    out, printed = process.communicate(timeout=60)
    assert out == "interrupted by SIGTERM to rank 1\n", printed


def by_shell(ranks, command, folder, **settings):
    """(exit code, standard output, standard error) of a shell's command on ranks, in a folder."""
    words = [MPIEXEC, "-n", str(ranks), "sh", "-c", command]
    env = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHON": sys.executable, **settings}
    done = subprocess.run(
        words, cwd=folder, env=env, capture_output=True, text=True, check=False, timeout=60
    )
    return done.returncode, done.stdout, done.stderr


RUN = 'exec "$PYTHON" -m surrofe2 run recipe.toml --law rve --out out'


def test_ranks_of_other_sources_are_refused(recipe_path, tmp_path):
    shutil.copytree(
        ROOT / "surrofe2",
        tmp_path / "doctored" / "surrofe2",
        ignore=shutil.ignore_patterns("*.pyc"),
    )
    with (tmp_path / "doctored" / "surrofe2" / "rve" / "newton.py").open("a") as file:
        file.write("# another version\n")
    other = f'test "$PMI_RANK" = 0 || export PYTHONPATH={tmp_path / "doctored"}; {RUN}'
    code, out, printed = by_shell(2, other, tmp_path)
    assert (code, out) == (1, "")
    assert printed.startswith("error: mpiexec: rank 1 has other sources of surrofe2 (")
    assert printed.endswith("; install the same on all machines\n")
    assert printed.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("module", ["mpi4py", "typer"])
def test_a_rank_that_does_not_come_to_mpi_ends_the_others(recipe_path, tmp_path, module):
    (tmp_path / "broken" / module).mkdir(parents=True)
    (tmp_path / "broken" / module / "__init__.py").write_text("raise ImportError('no such thing')")
    path = f"{tmp_path / 'broken'}:{ROOT}"
    code, _, printed = by_shell(
        2, f'test "$PMI_RANK" = 0 || export PYTHONPATH={path}; {RUN}', tmp_path
    )
    assert code != 0
    assert "no such thing" in printed


def test_ranks_with_recipes_of_their_own_are_told_apart(recipe_path, tmp_path):
    for k in range(2):
        shutil.copy(recipe_path, tmp_path / f"member-{k}.toml")
    own = 'exec "$PYTHON" -m surrofe2 run member-$PMI_RANK.toml --law rve --out out-$PMI_RANK'
    code, _, printed = by_shell(2, own, tmp_path)
    assert code != 0  # 1, or what MPICH gives where a rank is ended before the other is through
    assert printed.startswith(
        "error: mpiexec: rank 1 was called with 'member-1.toml', rank 0 with 'member-0.toml'; "
    )
    assert "SURROFE2_ALONE=1" in printed
    assert printed.count("\n") == 1
    checked = '"$PYTHON" -m surrofe2 check --only member-$PMI_RANK.toml'
    code, out, printed = by_shell(2, checked, tmp_path, SURROFE2_ALONE="1")
    assert (code, printed) == (0, "")
    assert {f"member-{k}.toml: no problem found" in out for k in range(2)} == {True}


def test_commands_that_do_not_run_on_ranks_are_refused_once(recipe_path, tmp_path):
    for command in ("generate recipe.toml", "compare out"):
        code, out, printed = by_shell(3, f'"$PYTHON" -m surrofe2 {command}', tmp_path)
        assert (code, out) == (1, "")
        name = command.split()[0]
        assert printed.startswith(f"error: {name}: 3 ranks were started, and only run shares")
        assert printed.count("\n") == 1


@pytest.mark.slow
def test_a_signal_to_any_rank_keeps_the_run_and_says_so(long_run, tmp_path):
    process = on_ranks(2, *long_run, module="surrofe2")
    os.kill(begun(process, tmp_path / "out")[1], signal.SIGTERM)
    _, printed = process.communicate(timeout=60)
    assert process.returncode == 143
    lines = printed.splitlines()
    (message,) = [line for line in lines if "interrupted" in line]
    assert message.startswith(f"interrupted by SIGTERM to rank 1: {tmp_path / 'out'} keeps the run")
    assert "nothing was changed" not in printed
    assert read_record(tmp_path / "out").status == "interrupted"
