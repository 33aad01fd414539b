"""Work that several processes do is what one process does, also where some of them are lost."""

import os
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context

import pytest

from surrofe2 import RveLaw, load_recipe, sample_stress
from surrofe2.base.errors import InputError, SimulationError
from surrofe2.store.samples import read_data_set
from surrofe2.workflow import workers
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.grid import run_grid
from surrofe2.workflow.workers import ATTEMPTS, executor_of, in_pieces
from tests.conftest import RECIPE, ROOT, changed
from tests.folders import assert_same
from tests.processes import python
from tests.some_work import killed_once, squares, squares_cut_off, squares_or_death, stresses

ALL = range(5, 61)


@pytest.fixture(autouse=True)
def _short_pieces(monkeypatch):
    monkeypatch.setattr(workers, "PIECE", 1e-9)


def joined(work, executor=None, unit=3):
    return [number for piece in in_pieces(work, ALL, unit, executor) for number in piece]


def test_without_an_executor_and_by_any_of_concurrent_futures():
    assert joined(squares) == [k * k for k in ALL]
    with ThreadPoolExecutor(3) as executor:
        assert joined(squares, executor) == joined(squares)


def test_what_a_lost_process_had_is_done_again(tmp_path):
    with executor_of(2) as executor:
        assert joined(partial(squares_or_death, str(tmp_path), 2), executor) == joined(squares)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_process_that_dies_while_it_writes_its_result_keeps_no_one_waiting(tmp_path):
    signal.alarm(60)  # ends the test where it waits for ever
    with executor_of(2) as executor:
        work = partial(squares_cut_off, str(tmp_path))
        pieces = [result for result, _ in in_pieces(work, range(60), 3, executor)]
    signal.alarm(0)
    assert [number for each in pieces for number in each] == [k * k for k in range(60)]


def test_work_that_kills_every_process_ends_with_a_sentence(tmp_path):
    with executor_of(1) as executor, pytest.raises(SimulationError, match="lost its worker"):
        joined(partial(squares_or_death, str(tmp_path), 99), executor)
    assert len(list(tmp_path.iterdir())) == ATTEMPTS


def test_processes_end_with_what_started_them(tmp_path):
    """Also where that is killed and can tell them nothing."""
    code = (
        "import time; from surrofe2.workflow.workers import Processes; import os\n"
        "if __name__ == '__main__':\n"
        "    pool = Processes(2); print(pool.submit(os.getpid).result(), flush=True)\n"
        "    time.sleep(60)"
    )
    (tmp_path / "starts.py").write_text(code, encoding="utf-8")
    command = [sys.executable, str(tmp_path / "starts.py")]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=quiet, text=True) as process:
        worker = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
    for _ in range(100):
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("a process is left behind")


def test_a_data_set_is_the_same_from_one_process_and_from_several(changed_recipe):
    study = load_recipe(changed_recipe("count = 40", "count = 300")).study()
    alone = study.with_cell(samples=replace(study.cell.samples, file="alone.h5"))
    generate_data_set(alone, chunk=64)
    with executor_of(2) as executor:
        made = generate_data_set(study, chunk=64, executor=executor)
        law = RveLaw(study.cell.parameters, study.recipe.rve)
        by_two = sample_stress(law, study.cell.range, 1200, executor=executor, tangents=False)
    assert len(made.samples.F) == 300
    assert read_data_set(made.path).fingerprint == read_data_set(alone.data_path()).fingerprint
    assert (
        by_two.fingerprint == sample_stress(law, study.cell.range, 1200, tangents=False).fingerprint
    )


FORKS = """
import multiprocessing, sys
from concurrent.futures import ProcessPoolExecutor
from surrofe2.workflow import workers
from tests.some_work import stresses

workers.PIECE = 1e-9
if sys.argv[1] != "early":
    stresses(0, 1)
with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as executor:
    if sys.argv[1] == "unseen":
        workers.prepare = lambda executor: None
    print(*workers.in_pieces(stresses, range(6), 2, executor))
"""


def test_a_pool_that_forks_before_kernels_have_run_does_what_one_process_does():
    printed = python("-c", FORKS, "early", cwd=ROOT).stdout
    assert printed.split() == [str(stresses(first, 2)) for first in (0, 2, 4)]


@pytest.mark.parametrize(
    ("when", "message"),
    [
        ("late", "executor: a ProcessPoolExecutor that forks, of a process that has run kernels"),
        ("unseen", "the executor lost its processes"),
    ],
)
def test_a_pool_that_forks_after_kernels_have_run_is_refused(when, message):
    last = python("-c", FORKS, when, code=1, cwd=ROOT).stderr.splitlines()[-1]
    assert message in last
    assert 'mp_context=multiprocessing.get_context("spawn")' in last


def test_a_pool_that_does_not_say_how_it_starts_its_processes_is_taken():
    with ProcessPoolExecutor(1, get_context("spawn")) as executor:
        del executor._mp_context  # private, so a later Python may have none
        workers.prepare(executor)


GUARDLESS = """
import os
from surrofe2.workflow.workers import executor_of
with executor_of(2) as executor:
    print(executor.submit(os.getpid).result())
"""
WRONG = """
import os
from surrofe2.workflow.workers import executor_of
if __name__ != "__main__":
    raise ImportError("in workers alone")
if __name__ == "__main__":
    with executor_of(1) as executor:
        executor.submit(os.getpid).result()
"""


@pytest.mark.parametrize(
    ("script", "lines", "message"),
    [
        (GUARDLESS, 0, "InputError: {}: each worker imports it, and it starts workers as it is "),
        (WRONG, 1, "SimulationError: a worker ended with exit code 1 as it started, see its error"),
    ],
    ids=["no guard", "an error"],
)
def test_a_script_that_workers_cannot_import_is_named(tmp_path, script, lines, message):
    """Its error is printed by one worker; a missing guard by none."""
    path = tmp_path / "study.py"
    path.write_text(script, encoding="utf-8")
    printed = python(path, code=1).stderr
    assert message.format(path) in printed.splitlines()[-1]
    assert 'below `if __name__ == "__main__":`' in printed.splitlines()[-1]
    assert printed.count("ImportError: in workers alone") == lines


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((2, "tcp://127.0.0.1:8786"), "--workers: 2; with --scheduler the cluster"),
        ((0, "nonsense://127.0.0.1:1"), "--scheduler: nonsense://127.0.0.1:1; no scheduler"),
        ((-1,), "workers: -1; it must be at least 1"),
    ],
)
def test_wrong_executors(arguments, sentence):
    with pytest.raises(InputError, match=re.escape(sentence)), executor_of(*arguments):
        pass


@pytest.mark.slow
def test_a_cluster_of_dask_that_loses_a_worker(tmp_path):
    distributed = pytest.importorskip("distributed")
    two = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with (
        distributed.LocalCluster(**two) as cluster,
        executor_of(0, cluster.scheduler_address) as executor,
    ):
        assert joined(partial(squares_or_death, str(tmp_path), 1), executor) == joined(squares)
    assert len(list(tmp_path.iterdir())) == 1


class Killing:
    """An executor whose first process that runs is killed."""

    def __init__(self, inner, folder):
        self.inner, self.folder = inner, folder

    def submit(self, work, *arguments):
        told = str(self.folder), "out/rve*/run.json", work
        return self.inner.submit(killed_once, *told, *arguments)


@pytest.mark.slow
def test_two_processes_of_which_one_is_killed_give_the_bits_of_one(tmp_path, caplog):
    def grid(folder, **executor):
        values = {"cell.wall_stiffness": (3000, 5000)}
        path, laws = folder / "recipe.toml", ("rve", "cached")
        path.write_text(changed(RECIPE, "= 40\nseed", "= 60\nseed", "= 4.0", "= 1.0"), "utf-8")
        run_grid(path, values, folder / "out", laws=laws, threads=1, **executor)

    (alone := tmp_path / "alone").mkdir()
    (both := tmp_path / "both").mkdir()
    grid(alone)
    with executor_of(2) as executor:
        grid(both, executor=Killing(executor, both))
    assert (both / "dead").exists()
    assert "a worker was lost" in caplog.text
    assert len([*(both / "out").glob("*/run.json")]) == 4
    assert_same(both / "out", alone / "out")
