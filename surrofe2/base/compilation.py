"""How every kernel is compiled: one place for numba's flags and for its cache.

numba's own cache looks at the file of the outermost function alone and would keep using machine
code whose inner functions, or constants from other files, have changed. Here the cache folder
carries a digest of every source file of the package, so that machine code always belongs to the
sources it is run with. Each file in it ends in its SHA-256, and a damaged one is compiled again
before anything of it runs. Where that folder cannot be written, kernels are compiled in memory.

numba gives each kernel copies of the functions that it calls, under names that all kernels share.
Of equal names the one that comes first into a process serves all, and copies that were optimised
in different surroundings round differently: results would depend on which kernels a process has
loaded or compiled before. Here a kernel keeps its copies to itself.
"""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import logging
import os
import pickle
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile
from time import perf_counter, process_time
from typing import Any

# Threads that wait for each other spin only briefly: spinning for long is a fifth faster on idle
# cores and ten times slower where another process wants one. Read when the first kernel starts.
os.environ.setdefault("GOMP_SPINCOUNT", "2000")

# Kernels allocate some 0.3 MB per tile and free it again. glibc would give such memory back to the
# system each time, and to get it again, zeroed, costs a cold solve 7 to 20 % of its time.
if hasattr(ctypes.CDLL(None), "mallopt"):  # not with another C library
    _TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
    ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, 32 << 20)
    ctypes.CDLL(None).mallopt(_TRIM_THRESHOLD, 64 << 20)

import numba
from numba.core.base import BaseContext
from numba.core.caching import IndexDataCacheFile
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from threadpoolctl import ThreadpoolController

# numba looks for SciPy's BLAS as it starts, only to choose an inner product for np.convolve and
# the like: that look takes as long as all of h5py. Kernels that need BLAS find it all the same.
_BLAS = "scipy.linalg.cython_blas"
if _BLAS not in sys.modules:
    sys.modules[_BLAS] = None  # type: ignore[assignment]
    import numba.np.arraymath

    del sys.modules[_BLAS]

log = logging.getLogger(__name__)

FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}  # not nnan, ninf: isnan must stay true
OPTIONS = {"error_model": "numpy", "fastmath": FAST}
"""Of all that is compiled; `numba.extending.overload` takes them as jit_options."""


PACKAGE = Path(__file__).parents[1]
_IMPORT = re.compile(
    r"^\s*(?:from|import)\s+surrofe2\.?([\w.]*)(?:\s+import\s+(\([^)]*\)|.*))?", re.M
)


def _digest(sources: Iterable[Path]) -> str:
    """16 hexadecimal digits of the names and contents of source files."""
    digest = hashlib.sha256()
    for source in sorted(sources):
        content = source.read_bytes()
        name = source.relative_to(PACKAGE) if source.is_relative_to(PACKAGE) else source
        digest.update(f"{name.as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16]


@cache
def _imported(source: Path) -> frozenset[Path]:
    """The files of the package that a source file imports; all files of a room it imports from."""
    files: set[Path] = set()
    for name, imported in _IMPORT.findall(source.read_text(encoding="utf-8")):
        place = PACKAGE.joinpath(*name.split(".")) if name else PACKAGE
        if place.is_dir():
            modules = {place / f"{word}.py" for word in re.findall(r"\w+", imported)}
            known = {module for module in modules if module.is_file()}
            files |= known or {*place.rglob("*.py")}
        else:
            files.add(place.with_suffix(".py"))
    return frozenset(files)


@cache
def _digest_of_kernels(source: Path) -> str:
    """That of all sources on which the machine code of this file's kernels can depend."""
    sources, new = set(), {source}
    while new:
        sources |= new
        new = {each for one in new for each in _imported(one)} - sources
    return _digest(sources)


@cache
def cache_folder() -> Path:
    """Where results of exactly these sources are kept between processes."""
    return _cache_root() / _digest(PACKAGE.rglob("*.py"))


def _cache_root() -> Path:
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    try:
        base = Path(home) if home else Path.home() / ".cache"
    except RuntimeError:  # a user without a home; below this, nothing can be kept
        base = Path(os.devnull)
    return base / "surrofe2"


@cache
def _kernels_root() -> Path | None:
    """Where kernels of all sources are kept; None where that cannot be written."""
    try:
        root = _cache_root() / "kernels"
        root.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=root) as file:
            file.write(bytes(4096))
    except OSError as error:
        _tell_once(f"{error}")
        return None
    return root


_waited = [0.0, 0.0]
"""Seconds of wall and of CPU in which kernels were compiled or read."""
_begun: list[tuple[float, float]] = []
"""When those began that are not finished: the kernels that one calls are compiled within it."""


@contextmanager
def _waiting() -> Iterator[None]:
    """While a kernel is compiled or read."""
    _begun.append((perf_counter(), process_time()))
    try:
        yield
    finally:
        wall, cpu = _begun.pop()
        if not _begun:
            _waited[0] += perf_counter() - wall
            _waited[1] += process_time() - cpu


def clock() -> float:
    """Seconds of a clock that stands while this process compiles kernels or reads them."""
    now = _begun[0][0] if _begun else perf_counter()
    return now - _waited[0]


def seconds_compiling() -> float:
    """Seconds of wall in which this process compiled kernels or read them so far."""
    return _waited[0]


class Meter:
    """Seconds from now on, after those of an earlier call; compilation is not counted."""

    def __init__(self, before: float = 0.0) -> None:
        self._begun = clock() - before

    @property
    def seconds(self) -> float:
        """All until now."""
        return clock() - self._begun


def cpu_clock() -> float:
    """Seconds of CPU, but for those that this process compiles kernels or reads them."""
    now = _begun[0][1] if _begun else process_time()
    return now - _waited[1]


@cache
def _tell_once(why: str) -> None:
    log.warning("kernels are compiled in memory and not kept, which takes a minute: %s", why)


class CheckedFiles(IndexDataCacheFile):
    """numba's files of a kernel, each ending in its SHA-256; a damaged one counts as absent."""

    def _load_index(self) -> dict[Any, str]:
        content = self._content(self._index_path)
        if content is None:
            return {}
        try:
            version, stamp, overloads = pickle.loads(content)
        except (AttributeError, ImportError):  # of arguments whose class has moved
            return {}
        return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        self._store(self._index_path, (self._version, self._source_stamp, overloads))

    def _load_data(self, name: str) -> Any:
        content = self._content(self._data_path(name))
        if content is None:
            raise FileNotFoundError(name)  # numba then compiles the kernel and saves it again
        try:
            return pickle.loads(content)
        except (AttributeError, ImportError) as error:  # as above
            raise FileNotFoundError(name) from error

    def _save_data(self, name: str, data: Any) -> None:
        self._store(self._data_path(name), data)

    def _content(self, path: str) -> bytes | None:
        try:
            stored = Path(path).read_bytes()
        except FileNotFoundError:
            return None
        if hashlib.sha256(stored[:-32]).digest() == stored[-32:]:
            return stored[:-32]
        _tell_damaged(self._cache_path)
        return None

    def _store(self, path: str, value: Any) -> None:
        content = self._dump(value)
        with self._open_for_write(path) as file:
            file.write(content + hashlib.sha256(content).digest())


@cache
def _tell_damaged(folder: str) -> None:
    log.warning("%s: damaged files of compiled kernels; they are compiled again", folder)


CACHE_LINE = 64
"""Bytes."""


class OwnCode(JITCodeLibrary):
    """Machine code without names that other kernels' code could stand in for."""

    _shared_module: Any

    def _finalize_final_module(self) -> None:
        if self._shared_module is None:  # what other kernels take copies of stays as it was
            self._shared_module = self._final_module.clone()
            _relink(self._shared_module, "external", "linkonce_odr")
        _relink(self._final_module, "linkonce_odr", "internal")
        super()._finalize_final_module()


def _relink(module: Any, before: str, after: str) -> None:
    for function in module.functions:
        if not function.is_declaration and function.linkage.name == before:
            function.linkage = after


@contextmanager
def own_code(codegen: Any) -> Iterator[None]:
    """Kernels compiled or read within are `OwnCode`; other people's are left as they are.

    Arrays that they make begin at a line of the cache: of others, numbers of eight lanes lie across
    two, and solves of RVEs take up to a fifth longer, by chance.
    """
    usual, usual_place = codegen._library_class, BaseContext.get_preferred_array_alignment
    codegen._library_class = OwnCode
    BaseContext.get_preferred_array_alignment = lambda *_: CACHE_LINE
    try:
        yield
    finally:
        codegen._library_class = usual
        BaseContext.get_preferred_array_alignment = usual_place


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with options of one's own, cached here."""
    options = {"cache": True, "no_cfunc_wrapper": True} | OPTIONS | options

    def decorate(function: Callable[..., Any]) -> Any:
        source = Path(function.__code__.co_filename)
        root = _kernels_root() if options["cache"] else None
        if root is None:
            return _own(numba.njit(**options | {"cache": False})(function))
        folder = root / _digest_of_kernels(source)
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(folder)
        try:
            dispatcher = numba.njit(**options)(function)
        finally:
            numba.config.CACHE_DIR = before
        # numba has no place to choose its files; without path and time of the source in them,
        # a package at another place uses the same kernels
        kept = dispatcher._cache
        kept._cache_file = CheckedFiles(str(folder), kept._impl.filename_base, folder.name)
        kept.save_overload = _saving(kept.save_overload, folder)
        kept._index_key = _with_sources_of_types(kept._index_key)
        return _own(dispatcher)

    return decorate


def _own(dispatcher: Any) -> Any:
    """The same kernel, whose machine code depends on no other kernel of the process."""
    compile_or_load = dispatcher.compile

    def own(signature: Any) -> Any:
        # of a constant, numba would make a kernel for each of its values
        signature = tuple(numba.types.unliteral(each) for each in signature)
        with global_compiler_lock, _waiting(), own_code(dispatcher.targetctx.codegen()):
            return compile_or_load(signature)

    dispatcher.compile = own
    return dispatcher


def _with_sources_of_types(index_key: Callable[..., tuple[Any, ...]]) -> Callable[..., Any]:
    """The key of a kernel's code with the sources of the named tuples that it takes as arguments.

    Callers choose these types: the kernel's own file need not import what defines them, and a
    tuple whose fields have changed places has the same signature.
    """

    def key(signature: Any, codegen: Any) -> tuple[Any, ...]:
        modules = {sys.modules[each] for each in _modules_of_types(signature)}
        sources = sorted(Path(str(module.__file__)) for module in modules)
        return (*index_key(signature, codegen), *map(_digest_of_kernels, sources))

    return key


def _modules_of_types(types: Iterable[Any]) -> Iterator[str]:
    """Where the package defines the classes of named tuples, nested ones too."""
    for each in types:
        if isinstance(each, numba.types.BaseNamedTuple):
            yield each.instance_class.__module__
        if isinstance(each, numba.types.BaseTuple):
            yield from _modules_of_types(each)


def _saving(save: Callable[..., None], folder: Path) -> Callable[..., None]:
    """`save` by one process at a time, for two would use one name; a full disk is no error."""

    def save_alone(*arguments: Any) -> None:
        try:
            with (folder / "lock").open("w") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                save(*arguments)
        except OSError as error:
            _tell_once(f"{error}")

    return save_alone


kernel = compiled()
"""A function of arrays and numbers, compiled."""

parallel_kernel = compiled(parallel=True)
"""A kernel whose `numba.prange` loops run on all cores; their bodies are one call of a kernel."""

pair_law = numba.njit(inline="always", **OPTIONS)
"""A formula that is written out where kernels use it."""


@cache
def _libraries() -> Any:
    """The libraries that are loaded; to look for them takes milliseconds."""
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[Any]:
    """BLAS works on one thread in the block: its matrices are small, and kernels need the cores."""
    limited: AbstractContextManager[Any] = _libraries().limit(limits=1, user_api="blas")
    return limited
