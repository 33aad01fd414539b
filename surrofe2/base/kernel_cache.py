"""Compiled kernels between processes: where they are kept, and of which sources.

numba's own cache looks at the file of the outermost function alone and would keep using machine
code whose inner functions, or constants from other files, have changed. Here the cache folder
carries a digest of every source file of the package, so that machine code always belongs to the
sources it is run with. Each file in it ends in its SHA-256, and a damaged one is compiled again
before anything of it runs. Where that folder cannot be written, kernels are compiled in memory.
"""

from __future__ import annotations

import hashlib
import logging
import os
import pickle
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

from surrofe2.base.locks import lock

log = logging.getLogger(__name__)

PACKAGE = Path(__file__).parents[1]
_DIGEST_SIZE = hashlib.sha256().digest_size  # bytes at the end of each file
# Statements that import from the package, by which the sources of a kernel are found.
_IMPORT = re.compile(
    r"^\s*(?:from|import)\s+surrofe2\.?([\w.]*)(?:\s+import\s+(\([^)]*\)|.*))?", re.M
)


def _digest(sources: Iterable[Path]) -> str:
    """Return 16 hexadecimal digits of the names and contents of source files."""
    digest = hashlib.sha256()
    for source in sorted(sources):
        content = source.read_bytes()
        name = source.relative_to(PACKAGE) if source.is_relative_to(PACKAGE) else source
        digest.update(f"{name.as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16]


@cache
def _imported(source: Path) -> frozenset[Path]:
    """Return the files of the package that a source file imports.

    Where it imports from a room, they are the named modules of the room, else all of its files.
    """
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
    """Return the digest of all sources on which the code of this file's kernels can depend."""
    sources: set[Path] = set()
    new = {source}
    while new:
        sources |= new
        imported = {file for source_file in new for file in _imported(source_file)}
        new = imported - sources
    return _digest(sources)


@cache
def cache_folder() -> Path:
    """Return where results of exactly these sources are kept between processes."""
    return _cache_root() / _digest(PACKAGE.rglob("*.py"))


def _cache_root() -> Path:
    """Return the folder of all that the package keeps between processes."""
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    try:
        base = Path(home) if home else Path.home() / ".cache"
    except RuntimeError:  # a user without a home; below this, nothing can be kept
        base = Path(os.devnull)
    return base / "surrofe2"


def folder_of_kernels(source: Path) -> Path | None:
    """Return where the kernels of a source file are kept; None where nothing can be written."""
    root = _kernels_root()
    return None if root is None else root / _digest_of_kernels(source)


@cache
def _kernels_root() -> Path | None:
    """Return where kernels of all sources are kept; None where that cannot be written."""
    try:
        root = _cache_root() / "kernels"
        root.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=root) as file:
            file.write(bytes(4096))
    except OSError as error:
        _tell_once(f"{error}")
        return None
    return root


@cache
def _tell_once(why: str) -> None:
    """Warn that kernels are not kept, once for each reason."""
    log.warning("kernels are compiled in memory and not kept, which takes a minute: %s", why)


class CheckedFiles(IndexDataCacheFile):
    """numba's files of a kernel, each ending in its SHA-256; a damaged one counts as absent."""

    def save(self, key: Any, data: Any) -> None:
        """Keep machine code under the digest of its key.

        numba numbers the files of a kernel. Two processes could give one number to different
        signatures where the file system keeps no locks.
        """
        overloads = self._load_index()
        if key not in overloads:
            name = hashlib.sha256(self._dump(key)).hexdigest()[:16]
            overloads[key] = f"{self._index_name.removesuffix('.nbi')}.{name}.nbc"
            self._save_index(overloads)
        self._save_data(overloads[key], data)

    def _load_index(self) -> dict[Any, str]:
        """Return the names of files of machine code by key; none of other sources or versions."""
        content = self._content(self._index_path)
        if content is None:
            return {}
        try:
            version, stamp, overloads = pickle.loads(content)
        except (AttributeError, ImportError):  # of arguments whose class has moved
            return {}
        return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        """Write the names of the files of machine code."""
        self._store(self._index_path, (self._version, self._source_stamp, overloads))

    def _load_data(self, name: str) -> Any:
        """Read machine code; a `FileNotFoundError` where it is missing or damaged."""
        content = self._content(self._data_path(name))
        if content is None:
            raise FileNotFoundError(name)  # numba then compiles the kernel and saves it again
        try:
            return pickle.loads(content)
        except (AttributeError, ImportError) as error:  # as above
            raise FileNotFoundError(name) from error

    def _save_data(self, name: str, data: Any) -> None:
        """Write machine code."""
        self._store(self._data_path(name), data)

    def _content(self, path: str) -> bytes | None:
        """Return the content of a file without its SHA-256; None where it is missing or damaged."""
        try:
            stored = Path(path).read_bytes()
        except FileNotFoundError:
            return None
        content = stored[:-_DIGEST_SIZE]
        if hashlib.sha256(content).digest() == stored[-_DIGEST_SIZE:]:
            return content
        _tell_damaged(self._cache_path)
        return None

    def _store(self, path: str, value: Any) -> None:
        """Write a value, followed by its SHA-256."""
        content = self._dump(value)
        with self._open_for_write(path) as file:
            file.write(content + hashlib.sha256(content).digest())


@cache
def _tell_damaged(folder: str) -> None:
    """Warn of damaged files in a folder, once."""
    log.warning("%s: damaged files of compiled kernels; they are compiled again", folder)


class _Place:
    """The place of a kernel's files, as numba asks for it."""

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        self._folder = folder
        self._line = function.__code__.co_firstlineno
        self._py_file = function.__code__.co_filename  # for numba's warnings

    def ensure_cache_path(self) -> None:
        """Make the folder."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_disambiguator(self) -> str:
        """Return what tells functions of one name in one file apart."""
        return str(self._line)


class _Kernel(CompileResultCacheImpl):
    """Writes and reads the machine code of a kernel as numba does, under names of its own.

    Its own constructor is left out: it would choose a place by settings of the process.
    """

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        self._lineno = function.__code__.co_firstlineno
        self._locator = _Place(function, folder)
        module = Path(function.__code__.co_filename).stem
        self._filename_base = self.get_filename_base(
            f"{module}.{function.__qualname__}", getattr(sys, "abiflags", "")
        )


class KernelCache(FunctionCache):
    """The kept machine code of one kernel, by its signatures.

    Without path and time of the source in them, files serve a package at another place as well.
    """

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        self.is_part = False  # set before each use
        self._name = repr(function)
        self._py_func = function
        self._folder = folder
        self._cache_path = str(folder)
        self._impl = _Kernel(function, folder)
        self._cache_file = CheckedFiles(str(folder), self._impl.filename_base, folder.name)
        self.enable()

    def save_overload(self, signature: Any, data: Any) -> None:
        """Keep machine code, one process at a time; a full disk is no error."""
        try:
            self._impl.locator.ensure_cache_path()
            with (self._folder / "lock").open("w") as file:
                lock(file, wait=True)  # without locks, one of two kernels may be compiled again
                super().save_overload(signature, data)
        except OSError as error:
            _tell_once(f"{error}")

    def _index_key(self, signature: Any, codegen: Any) -> tuple[Any, ...]:
        """Return numba's key with what else the code depends on.

        These are whether the kernel is a part of others, and the sources of the named tuples that
        it takes. Callers choose these types: the kernel's own file need not import what defines
        them, and a tuple whose fields have changed places has the same signature.
        """
        modules = {sys.modules[name] for name in _modules_of_types(signature)}
        sources = sorted(Path(str(module.__file__)) for module in modules)
        digests = map(_digest_of_kernels, sources)
        return (*super()._index_key(signature, codegen), self.is_part, *digests)


def _modules_of_types(types: Iterable[Any]) -> Iterator[str]:
    """Yield the modules of the package that define the classes of named tuples, nested ones too."""
    for kind in types:
        if isinstance(kind, numba.types.BaseNamedTuple):
            yield kind.instance_class.__module__
        if isinstance(kind, numba.types.BaseTuple):
            yield from _modules_of_types(kind)
