"""Machine code belongs to the sources it is run with, and has the same bits in every process."""

import inspect
import os
import shutil
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import pytest
from numba.core.base import BaseContext
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    IndexDataCacheFile,
    NullCache,
)
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.cpu import CPUContext

import surrofe2
from tests.processes import python

PACKAGE = Path(surrofe2.__file__).parent

# A kernel that bakes in a constant of a file without kernels: 7 inputs of a law.
PROBE = """
from surrofe2.base.compilation import kernel
from surrofe2.base.tensors import INPUTS

@kernel
def inputs(number):
    return number * INPUTS
"""
INPUTS = """
from surrofe2.probe import inputs
print(inputs(1), inputs.stats.cache_hits.total(), inputs.stats.cache_misses.total())
"""


def copied(folder):
    """A copy of the package that nothing else runs, in a folder."""
    shutil.copytree(PACKAGE, folder / "surrofe2", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "surrofe2" / "probe.py").write_text(PROBE, encoding="utf-8")
    return folder / "surrofe2"


@pytest.fixture
def copy(tmp_path):
    return copied(tmp_path)


def answer(copy, setting=""):
    """What the copy's kernel answers, inputs, cache hits and cache misses, and what it warns of."""
    given = {"PYTHONPATH": str(copy.parent), "NUMBA_CACHE_DIR": str(copy.parent / "kernels")}
    done = python("-c", setting + INPUTS, env={**os.environ, **given}, cwd=copy.parent)
    return [int(number) for number in done.stdout.split()], done.stderr.splitlines()


@pytest.mark.slow
def test_two_first_starts_at_once_and_an_edited_constant_of_another_file(copy):
    """The second start reads what the first kept; a change of any source file compiles anew."""
    with ThreadPoolExecutor(2) as pool:
        both = [*pool.map(answer, [copy, copy])]
    assert [(numbers[0], told) for numbers, told in both] == [(7, [])] * 2
    assert answer(copy) == ([7, 1, 0], [])
    constants = copy / "base" / "tensors.py"
    text = constants.read_text(encoding="utf-8")
    assert "surrofe2.base.compilation" not in text
    assert text.count("\nINPUTS = 7\n") == 1
    constants.write_text(text.replace("\nINPUTS = 7\n", "\nINPUTS = 5\n"), encoding="utf-8")
    assert answer(copy) == ([5, 0, 1], [])


NO_HOME = """
import os, pwd
def nobody(*_):
    raise KeyError
pwd.getpwuid = nobody
for name in ("HOME", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
    os.environ.pop(name, None)
"""
FULL = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))
"""


@pytest.mark.parametrize(
    ("setting", "why"), [(NO_HOME, "Not a directory"), (FULL, "File too large")]
)
def test_without_a_place_to_keep_them_kernels_are_compiled_in_memory(copy, setting, why):
    numbers, (line,) = answer(copy, setting)
    assert numbers[:2] == [7, 0]
    assert "kernels are compiled in memory and not kept, which takes a minute: " in line
    assert why in line
    assert not [*copy.parent.rglob("*.nbc")]


NO_LOCKS = """
import errno, fcntl, os
def flock(*_):
    raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))
fcntl.flock = flock
"""


def test_without_locks_kernels_are_kept(copy):
    with ThreadPoolExecutor(2) as pool:
        both = [*pool.map(answer, [copy, copy], [NO_LOCKS, NO_LOCKS])]
    assert [(numbers[0], told) for numbers, told in both] == [(7, [])] * 2
    assert answer(copy, NO_LOCKS) == ([7, 1, 0], [])


def test_names_of_numba_that_are_replaced_are_there():
    """A version of numba without them would silently do as it usually does."""
    names = {
        BaseContext: ["get_preferred_array_alignment"],
        JITCodeLibrary: [
            "_optimize_final_module", "_finalize_final_module", "_finalize_dynamic_globals",
            "_ensure_finalized", "get_pointer_to_function", "serialize_using_object_code",
            "_unserialize", "_get_module_for_linking", "_set_compiled_object",
            "enable_object_caching",
        ],
        JITCPUCodegen: ["_library_class", "set_env"],
        CPUContext: ["get_executable", "get_env_name"],
        numba._dynfunc: ["make_function"],
        CompileResultCacheImpl: ["get_filename_base", "locator", "reduce", "rebuild"],
        FunctionCache: ["save_overload", "_index_key", "enable"],
        IndexDataCacheFile: [
            "save", "load", "_load_index", "_save_index", "_load_data", "_save_data", "_data_path",
            "_dump", "_open_for_write",
        ],
    }  # fmt: skip
    for owner, each in names.items():
        assert [name for name in each if not hasattr(owner, name)] == []
    library = inspect.getsource(JITCodeLibrary.__base__)
    assert all(name in library for name in ("_shared_module", "_final_module"))
    dispatcher = numba.njit(squared)
    assert isinstance(dispatcher._cache, NullCache)
    assert callable(dispatcher.compile)
    assert callable(dispatcher._insert)
    assert dispatcher.overloads == {}
    cached = vars(FunctionCache(squared))
    assert {"_name", "_py_func", "_impl", "_cache_path", "_cache_file"} < cached.keys()
    assert {"_lineno", "_locator", "_filename_base"} <= vars(cached["_impl"]).keys()
    assert {"_version", "_source_stamp", "_index_path"} < vars(cached["_cache_file"]).keys()


def squared(number):
    return number**2


DAMAGES = {
    "a flipped bit in machine code": ("*.nbc", lambda content: flipped(content, 0.5)),
    "truncated code": ("*.nbc", lambda content: content[: len(content) // 2]),
    "empty code": ("*.nbc", lambda content: b""),
    "a flipped bit in an index": ("*.nbi", lambda content: flipped(content, 0.3)),
    "an empty index": ("*.nbi", lambda content: b""),
}


def flipped(content, place):
    k = int(place * len(content))
    return content[:k] + bytes([content[k] ^ 16]) + content[k + 1 :]


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A folder with a copy of the package and the kernels that it has kept."""
    folder = tmp_path_factory.mktemp("compiled")
    assert answer(copied(folder))[0][0] == 7
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_kernel_is_compiled_again_with_one_note(compiled, tmp_path, damage):
    pattern, change = DAMAGES[damage]
    copy = shutil.copytree(compiled, tmp_path / "damaged") / "surrofe2"
    files = [*(copy.parent / "kernels").rglob(pattern)]
    assert files
    for path in files:
        path.write_bytes(change(path.read_bytes()))
    numbers, (line,) = answer(copy)
    assert numbers[:2] == [7, 0]
    assert "damaged files of compiled kernels; they are compiled again" in line
    if damage == next(iter(DAMAGES)):
        assert answer(copy) == ([7, 1, 0], [])


KERNELS = """
import sys
import numba
import numpy as np
from surrofe2.base.compilation import kernel, loop_body, parallel_kernel

@kernel
def inner(a):
    if a.size > 8:  # calls itself, so that it is not written out where it is called
        return inner(a[:8]) - inner(a[8:])
    total = 0.0
    for k in range(a.size):
        total += np.sin(a[k]) / (1.0 + a[k])
    for k in range(a.size):
        a[k] = np.exp(-total * a[k])
    return total + np.arctan(total)

@kernel
def outer(a):
    return inner(a[:5]) * inner(a[5:]) + inner(a)

@kernel
def first(pair):
    return pair.x

@kernel
def some_arrays(n):
    return [np.empty((k, 3)) for k in range(1, n)]

@numba.njit
def of_a_user(x):
    return 2.0 * x

@loop_body
def doubled(a, k):
    a[k] = of_a_user(a[k])

@parallel_kernel
def all_doubled(a):
    for k in numba.prange(a.size):
        doubled(a, k)
"""


@pytest.fixture
def module(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS, encoding="utf-8")
    return tmp_path


def said(module, *lines):
    """What a new process says that has these kernels."""
    folders = {"PYTHONPATH": os.pathsep.join([str(module), *sys.path])}
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(module / "kept"), **folders}
    code = "\n".join(["from kernels import *", *lines])
    return python("-B", "-c", code, env=environment).stdout.split()


A = "a = np.linspace(0.1, 2.0, 13)"


def test_a_kernel_has_the_same_bits_whichever_was_compiled_or_read_before(module):
    """It is compiled alone; read after another; compiled into one that was read."""
    first = said(module, A, "print(inner(a.copy()).hex())")
    shown = "print({0}(a.copy()).hex(), {0}.stats.cache_hits.total())"
    again = said(module, A, *map(shown.format, ("inner", "outer", "inner")))
    assert again[:2] == [*first, "1"]
    assert again[3:5] == ["0", *first]
    both = said(module, A, "print(outer(a.copy()).hex(), inner(a.copy()).hex())")
    assert both == [again[2], *first]


NO_CODE = """
from surrofe2.base import machine_code
def parse_bitcode(code):
    raise AssertionError("nothing copies this kernel")
machine_code.parse_bitcode = parse_bitcode
"""


def test_a_kernel_that_the_cache_keeps_is_read_without_what_compilation_needs(module):
    first = said(module, A, "print(inner(a).hex())")
    again = said(module, NO_CODE, A, "print(inner(a).hex(), inner.stats.cache_hits.total())")
    assert again == [*first, "1"]


NOTED = """
from numba.core.codegen import JITCodeLibrary, CPUCodeLibrary
usual = {0}
names = []
def noted(library):
    names.append(library.name)
    usual(library)
{0} = noted
a = np.ones(3)
"""
WITH_MACHINE_CODE = NOTED.format("JITCodeLibrary._finalize_specific")
OPTIMISED = NOTED.format("CPUCodeLibrary._optimize_final_module")


def test_machine_code_is_made_once_of_what_python_calls(module):
    """Of a loop over all cores and the kernel in it numba would make it four times."""
    count, *rest = said(
        module, WITH_MACHINE_CODE, "all_doubled(a)", "print(len(names), *names, *a)"
    )
    # one more is of a user's function, which numba does not know to be ours
    assert count == "2"
    assert {*rest[:2]} == {"of_a_user", "all_doubled"}
    assert rest[2:] == ["2.0"] * 3


def test_the_body_of_a_loop_is_optimised_with_the_loop_alone(module):
    """Before that, too, it is only where Python calls it."""
    names = said(module, OPTIMISED, "all_doubled(a)", "print(*names)")
    assert names.count("all_doubled") == names.count("of_a_user") == 1
    assert not any("doubled" in name for name in names if name != "all_doubled")
    called = said(module, OPTIMISED, "all_doubled(a)", "doubled(a, 1)", "print(*names)")
    assert called.count("doubled") == 1


def test_what_a_kernel_calls_can_be_called_by_python_too(module):
    called = said(
        module, "a = np.ones(3)", "all_doubled(a)", "doubled(a, 1)", "print(of_a_user(4.0), *a)",
    )  # fmt: skip
    assert called == ["8.0", "2.0", "4.0", "2.0"]


def test_arrays_of_kernels_begin_at_a_line_of_the_cache(module):
    places = said(module, "print(*[a.ctypes.data % 64 for a in some_arrays(40)])")
    assert set(places) == {"0"}


PAIR = """
from typing import NamedTuple
class Pair(NamedTuple):
    {}: float
    {}: float
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("classes", "hits"),
    [
        ((("pairs", "x", "y"), ("pairs", "x", "y"), ("pairs", "y", "x")), ["0", "1", "0"]),
        ((("pairs", "x", "y"), ("couples", "x", "y")), ["0", "0"]),
    ],
    ids=["fields change places", "its module moves"],
)
def test_the_class_of_an_argument_may_change(module, classes, hits):
    """Neither the kernel's file nor the signature has changed; files of the kernel name the class's
    old module, which is no source that the kernel depends on."""
    found = []
    for name, *fields in classes:
        text = PAIR.format(*fields)
        (module / f"{name}.py").write_text(text, encoding="utf-8")
        shown = "print(int(first(Pair(x=3.0, y=5.0))), first.stats.cache_hits.total())"
        number, hit = said(module, f"from {name} import Pair", shown)
        assert number == "3"
        found.append(hit)
        (module / f"{name}.py").unlink()
    assert found == hits
