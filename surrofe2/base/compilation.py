"""The compilation of all kernels: one place for numba's flags."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.compiler_lock import global_compiler_lock
from threadpoolctl import ThreadpoolController

from surrofe2.base import environment
from surrofe2.base.clock import waiting
from surrofe2.base.kernel_cache import KernelCache, folder_of_kernels
from surrofe2.base.machine_code import is_part, kernel_code

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


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Make a decorator like `numba.njit` with these options; it caches kernels in `kernel_cache`.

    With `cache=False` it does not. For `is_loop_body` see the decorator `loop_body`.
    """
    options = {"no_cfunc_wrapper": True} | OPTIONS | options
    is_cached = options.pop("cache", True)
    is_loop_body = options.pop("is_loop_body", False)

    def decorate(function: Callable[..., Any]) -> Any:
        """Compile a function."""
        dispatcher = numba.njit(**options)(function)
        dispatcher.is_loop_body = is_loop_body
        folder = folder_of_kernels(Path(function.__code__.co_filename)) if is_cached else None
        if folder is not None:
            dispatcher._cache = KernelCache(function, folder)
        return _own(dispatcher)

    return decorate


def _own(dispatcher: Any) -> Any:
    """Return the same kernel, whose machine code depends on no other kernel of the process."""
    compile_or_load = dispatcher.compile
    let_python_call = dispatcher._insert
    # Signatures that were compiled only for kernels which call this one.
    parts: set[Any] = set()

    def own(signature: Any) -> Any:
        """Compile a signature, or load it, with its code to itself."""
        # of a constant, numba would make a kernel for each of its values
        signature = tuple(numba.types.unliteral(kind) for kind in signature)
        with global_compiler_lock, waiting(), kernel_code(dispatcher):
            if is_part():
                if signature not in dispatcher.overloads:
                    parts.add(signature)
            elif signature in parts:
                # it lacks machine code, so it is compiled again
                parts.remove(signature)
                dispatcher.overloads.pop(signature, None)
            dispatcher._cache.is_part = is_part()
            return compile_or_load(signature)

    def insert(codes: Any, entry: Any, is_object_mode: bool) -> None:
        """Let Python call what has machine code."""
        if not is_part():
            let_python_call(codes, entry, is_object_mode)

    dispatcher.compile = own
    dispatcher._insert = insert
    return dispatcher


# Decorator of a function of arrays and numbers, which is compiled.
kernel = compiled()

# Decorator of a kernel whose `numba.prange` loops run on all cores.
parallel_kernel = compiled(parallel=True)

# Decorator of a kernel that is the whole body of such a loop. It is optimised with the loop alone,
# since to optimise it before that only takes time.
loop_body = compiled(is_loop_body=True)

# Decorator of a formula that is written out where kernels use it.
pair_law = compiled(inline="always", cache=False)


@cache
def _libraries() -> Any:
    """Return the libraries that are loaded; to look for them takes milliseconds."""
    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[Any]:
    """Let BLAS work on one thread in the block: matrices are small, and kernels need the cores."""
    limited: AbstractContextManager[Any] = _libraries().limit(limits=1, user_api="blas")
    return limited
