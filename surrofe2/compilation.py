"""How every kernel is compiled: one place for numba's flags and for its cache.

numba's own cache looks at the file of the outermost function alone and would go on using machine
code whose inner functions, or constants from other files, have changed. Here the cache folder
carries a digest of every source file of the package, so that machine code always belongs to the
sources it is run with.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

# Threads that wait for each other spin only briefly: spinning for long is a fifth faster on idle
# cores and ten times slower where another process wants one. Read when the first kernel starts.
os.environ.setdefault("GOMP_SPINCOUNT", "2000")

import numba

# numba looks for SciPy's BLAS as it starts, only to choose an inner product for np.convolve and
# the like: that look takes as long as all of h5py. Kernels that need BLAS find it all the same.
_BLAS = "scipy.linalg.cython_blas"
if _BLAS not in sys.modules:
    sys.modules[_BLAS] = None  # type: ignore[assignment]
    import numba.np.arraymath

    del sys.modules[_BLAS]

FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}  # not nnan, ninf: isnan must stay true
OPTIONS = {"error_model": "numpy", "fastmath": FAST}
"""Of all that is compiled; `numba.extending.overload` takes them as jit_options."""


@cache
def source_digest() -> str:
    """16 hexadecimal digits of the names and contents of all source files of the package."""
    package, digest = Path(__file__).parent, hashlib.sha256()
    for source in sorted(package.rglob("*.py")):
        content = source.read_bytes()
        digest.update(f"{source.relative_to(package).as_posix()} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> Path:
    """Where compiled kernels of exactly these sources are kept between processes."""
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    base = Path(home) if home else Path.home() / ".cache"
    return base / "surrofe2" / source_digest()


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with options of one's own, cached here."""
    options = {"cache": True, "no_cfunc_wrapper": True} | OPTIONS | options

    def decorate(function: Callable[..., Any]) -> Any:
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(cache_folder())
        try:
            return numba.njit(**options)(function)
        finally:
            numba.config.CACHE_DIR = before

    return decorate


kernel = compiled()
"""A function of arrays and numbers, compiled."""

parallel_kernel = compiled(parallel=True)
"""A kernel whose `numba.prange` loops run on all cores; their bodies are one call of a kernel."""

pair_law = numba.njit(inline="always", **OPTIONS)
"""A formula that is written out where kernels use it."""
