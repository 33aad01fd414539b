"""The compilation of all kernels: one place for numba's flags.

numba gives each kernel copies of the functions that it calls, under names that all kernels share.
Of equal names the one that comes first into a process serves all, and copies that were optimised
in different surroundings round differently: results would depend on which kernels a process has
loaded or compiled before. Here a kernel keeps its copies to itself.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.base import BaseContext
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from threadpoolctl import ThreadpoolController

from surrofe2.base import environment
from surrofe2.base.clock import waiting
from surrofe2.base.kernel_cache import KernelCache, folder_of_kernels

# numba looks for SciPy's BLAS as it starts, only to choose an inner product for np.convolve and
# the like: that look takes as long as all of h5py. Kernels that need BLAS find it all the same.
# Other people's kernels may want that product, so numba looks unless the process is ours.
_BLAS = "scipy.linalg.cython_blas"
if environment.is_taken and _BLAS not in sys.modules:
    sys.modules[_BLAS] = None  # type: ignore[assignment]
    import numba.np.arraymath

    del sys.modules[_BLAS]

FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}  # not nnan, ninf: isnan must stay true
# Options of all that is compiled; `numba.extending.overload` takes them as jit_options.
OPTIONS = {"error_model": "numpy", "fastmath": FAST}


# Bytes of a line of the processor's cache.
CACHE_LINE = 64


class OwnCode(JITCodeLibrary):
    """Machine code without names that other kernels' code could stand in for."""

    _shared_module: Any

    def _finalize_final_module(self) -> None:
        """Complete the module, its copies of functions made private."""
        if self._shared_module is None:  # what other kernels take copies of stays as it was
            self._shared_module = self._final_module.clone()
            _relink(self._shared_module, "external", "linkonce_odr")
        _relink(self._final_module, "linkonce_odr", "internal")
        super()._finalize_final_module()


def _relink(module: Any, before: str, after: str) -> None:
    """Change the linkage of the functions of a module that have this one."""
    for function in module.functions:
        if not function.is_declaration and function.linkage.name == before:
            function.linkage = after


@contextmanager
def own_code(codegen: Any) -> Iterator[None]:
    """Make kernels compiled or read within `OwnCode`; other people's stay as they are.

    Arrays that they make begin at a line of the cache: of others, numbers of eight lanes lie across
    two, and solves of RVEs take up to a fifth longer, by chance.
    """
    usual_class = codegen._library_class
    usual_alignment = BaseContext.get_preferred_array_alignment
    codegen._library_class = OwnCode
    BaseContext.get_preferred_array_alignment = lambda *_: CACHE_LINE
    try:
        yield
    finally:
        codegen._library_class = usual_class
        BaseContext.get_preferred_array_alignment = usual_alignment


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Make a decorator like `numba.njit` with these options; it caches kernels in `kernel_cache`.

    With `cache=False` it does not.
    """
    options = {"no_cfunc_wrapper": True} | OPTIONS | options
    is_cached = options.pop("cache", True)

    def decorate(function: Callable[..., Any]) -> Any:
        """Compile a function."""
        dispatcher = numba.njit(**options)(function)
        folder = folder_of_kernels(Path(function.__code__.co_filename)) if is_cached else None
        if folder is not None:
            dispatcher._cache = KernelCache(function, folder)
        return _own(dispatcher)

    return decorate


def _own(dispatcher: Any) -> Any:
    """Return the same kernel, whose machine code depends on no other kernel of the process."""
    compile_or_load = dispatcher.compile

    def own(signature: Any) -> Any:
        """Compile a signature, or load it, with its code to itself."""
        # of a constant, numba would make a kernel for each of its values
        signature = tuple(numba.types.unliteral(kind) for kind in signature)
        with global_compiler_lock, waiting(), own_code(dispatcher.targetctx.codegen()):
            return compile_or_load(signature)

    dispatcher.compile = own
    return dispatcher


# Decorator of a function of arrays and numbers, which is compiled.
kernel = compiled()

# Decorator of a kernel whose `numba.prange` loops run on all cores; their bodies are one call of a
# kernel.
parallel_kernel = compiled(parallel=True)

# Decorator of a formula that is written out where kernels use it.
pair_law = numba.njit(inline="always", **OPTIONS)


@cache
def _libraries() -> Any:
    """Return the libraries that are loaded; to look for them takes milliseconds."""
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[Any]:
    """Let BLAS work on one thread in the block: matrices are small, and kernels need the cores."""
    limited: AbstractContextManager[Any] = _libraries().limit(limits=1, user_api="blas")
    return limited
