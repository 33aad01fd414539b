"""What importing the package and computing change of a process: nothing; and what it may use."""

import json
import os

import numba
import pytest

from surrofe2.base import environment
from surrofe2.base.environment import cores
from surrofe2.base.errors import InputError
from surrofe2.workflow.laws import use_threads
from tests.processes import python

SNAPSHOT = """
import importlib, locale, multiprocessing, os, signal, sys, threading, warnings

def snapshot():
    import gc, logging, numba, numpy, torch
    handlers = {number: repr(signal.getsignal(number)) for number in signal.valid_signals()}
    return {
        "environment": dict(os.environ),
        "signals": handlers,
        "timer": signal.getitimer(signal.ITIMER_REAL),
        "filters": repr(warnings.filters),
        "numpy": numpy.geterr(),
        "numba": {name: repr(getattr(numba.config, name)) for name in dir(numba.config)
                  if name.isupper()},
        "numba threads": numba.get_num_threads(),
        "torch": (torch.get_num_threads(), torch.get_default_dtype(), torch.get_default_device(),
                  torch.is_grad_enabled()),
        "start method": multiprocessing.get_start_method(allow_none=True),
        "locale": locale.setlocale(locale.LC_ALL),
        "hooks": (sys.excepthook, sys.unraisablehook, threading.excepthook, sys.stdout, sys.stderr),
        "garbage": (gc.get_threshold(), gc.isenabled()),
        "loggers": (logging.root.level, logging.root.handlers[:]),
        "limit": sys.getrecursionlimit(),
        "inner product": numba.np.arraymath._HAVE_BLAS,
        "numba classes": (numba.core.base.BaseContext.get_preferred_array_alignment,
                          numba.core.registry.cpu_target.target_context.codegen()._library_class),
    }

def compare(what):
    after = snapshot()
    for name, value in before.items():
        if after[name] != value:
            print(what, "changes", name, value, after[name])
    for name, module in modules.items():
        if sys.modules.get(name) is not module:
            print(what, "replaces", name)
    absent = [name for name, module in sys.modules.items() if module is None]
    if absent:
        print(what, "blocks", absent)

# Libraries set some of this themselves as they are loaded.
for name in "numba.core.registry numba.np.arraymath torch scipy.spatial scipy.linalg h5py skfem" \
            " sklearn.neighbors meshio threadpoolctl".split():
    importlib.import_module(name)
numba = sys.modules["numba"]
numba.njit(lambda: 1)()
import ctypes
allocator = ctypes.CDLL(None)
calls = []
before, modules = snapshot(), dict(sys.modules)
ctypes.CDLL = lambda *words: calls.append(words) or allocator

import surrofe2
compare("import")
import numpy as np
law = surrofe2.RveLaw(surrofe2.CellParameters.preset("printed"), initialisation="cauchy-born")
compare("a law")
F = np.tile(np.eye(2), (3, 1, 1))
law.respond(F, 0.0 * F, tangents=True)
compare("a stress")
print("calls of the C library:", calls)
print("spin:", ctypes.CDLL(None) is allocator and os.environ.get("GOMP_SPINCOUNT"))
"""


def test_import_and_a_stress_change_nothing_of_the_process():
    """The C library's allocator could be changed by a call of it alone."""
    names = ("GOMP_SPINCOUNT", "NUMBA_NUM_THREADS")
    host = {name: value for name, value in os.environ.items() if name not in names}
    lines = python("-c", SNAPSHOT, env=host).stdout.splitlines()
    assert lines == ["calls of the C library: []", "spin: None"]


BLAS = """
import sys
from surrofe2.base import environment
environment.is_taken = {}
import surrofe2.base.compilation
import numba.np.arraymath
print(numba.np.arraymath._HAVE_BLAS, sys.modules.get("scipy.linalg.cython_blas", 0) is None)
"""


@pytest.mark.parametrize("is_taken", [True, False])
def test_numba_looks_for_blas_unless_the_process_is_ours(is_taken):
    """The look takes as long as all of h5py, and other people's kernels may need it."""
    assert python("-c", BLAS.format(is_taken)).stdout.split() == [str(not is_taken), "False"]


COMMAND = """
import ctypes, json, os, sys
from surrofe2.base import environment

calls = []
load = ctypes.CDLL

class Library:
    def mallopt(self, *words):
        loaded = [name for name in ("numba", "torch") if name in sys.modules]
        calls.append([words, environment.is_taken, os.environ.get("GOMP_SPINCOUNT"), loaded])

ctypes.CDLL = lambda name, *words, **more: Library() if name is None else load(name, *words, **more)
from surrofe2 import cli
before = environment.is_taken, len(calls), os.environ.get("GOMP_SPINCOUNT")
sys.argv = ["surrofe2", *sys.argv[1:]]
try:
    cli.main()
finally:
    sys.stderr.write(json.dumps([before, calls]))
"""


@pytest.mark.parametrize(
    ("words", "before", "spin"),
    [
        (("run", "--help"), None, "2000"),
        (("tissue", "--help"), None, "20000"),
        (("run", "--help"), "7", "7"),
        (("--help",), None, None),
    ],
    ids=["run", "tissue", "as the user has set it", "no command"],
)
def test_the_command_line_sets_its_process(words, before, spin):
    """By the calls of the C library themselves, while libraries can still read what is set, and
    only once it is known which command is called."""
    host = {name: value for name, value in os.environ.items() if name != "GOMP_SPINCOUNT"}
    if before is not None:
        host["GOMP_SPINCOUNT"] = before
    printed = python("-c", COMMAND, *words, env=host).stderr
    at_first, calls = json.loads(printed.splitlines()[-1])
    assert at_first == [False, 0, before]
    settings = [] if spin is None else [[-3, 32 << 20], [-1, 64 << 20]]
    assert calls == [[each, True, spin, []] for each in settings]


@pytest.fixture
def host(monkeypatch, tmp_path):
    """host(bound, own, files): so many cores by affinity, and control groups."""

    def make(bound, own="", **files):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(bound)))
        monkeypatch.setattr(environment, "_CGROUPS", tmp_path / "cgroup")
        monkeypatch.setattr(environment, "_OWN", tmp_path / "own")
        (tmp_path / "own").write_text(own)
        for name, text in files.items():
            path = tmp_path / "cgroup" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

    return make


def version_1(quota):
    folder = "cpu/batch/cpu.cfs_"
    return {f"{folder}quota_us": quota, f"{folder}period_us": "100000"}


@pytest.mark.parametrize(
    ("bound", "own", "files", "expected"),
    [
        (4, "", {}, 4),
        (4, "0::/job/step", {"job/cpu.max": "250000 100000", "job/step/cpu.max": "max 100000"}, 2),
        (4, "0::/", {"cpu.max": "50000 100000"}, 1),
        (4, "0::/elsewhere", {"cpu.max": "300000 100000"}, 3),
        (2, "0::/", {"cpu.max": "800000 100000"}, 2),
        (4, "0::/", {"cpu.max": "max 100000"}, 4),
        (4, "0::/", {"cpu.max": "nonsense"}, 4),
        (
            4,
            "1:cpu,cpuacct:/batch",
            version_1("200000"),
            2,
        ),
        (4, "1:cpu:/batch\n0::/", version_1("-1"), 4),
        (4, "1:cpuset:/batch", version_1("200000"), 4),
    ],
)
def test_cores_are_those_of_affinity_and_quota(host, bound, own, files, expected):
    host(bound, own, **files)
    assert cores() == expected


def test_a_quota_limits_the_threads_of_libraries(host, monkeypatch):
    for name in ("GOMP_SPINCOUNT", *environment._THREADS):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    host(4, "0::/", **{"cpu.max": "200000 100000"})
    environment.take_process()
    assert os.environ["NUMBA_NUM_THREADS"] == "2"
    assert os.environ["OMP_NUM_THREADS"] == "3"  # as the user has set it


def test_more_threads_than_cores_are_refused(host):
    """By affinity, by quota, or by numba's own limit, which would raise a ValueError."""
    count = numba.config.NUMBA_NUM_THREADS
    host(1)
    use_threads(1)
    with pytest.raises(InputError, match="--threads: 2; this process may use 1: it has 1 of"):
        use_threads(2)
    host(99)
    with pytest.raises(InputError, match=f"NUMBA_NUM_THREADS is {count}"):
        use_threads(count + 1)
