"""How every kernel is compiled: one place for numba's flags and for its cache.

numba's own cache looks at the file of the outermost function alone and would go on using machine
code whose inner functions have changed. Here the cache folder carries a digest of all sources
that define kernels, so that a changed line is never outrun by an old kernel.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

# Threads that wait for each other spin only briefly: spinning for long is a fifth faster on idle
# cores and ten times slower where another process wants one. Read when the first kernel starts.
os.environ.setdefault("GOMP_SPINCOUNT", "2000")

import numba

FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}  # not nnan, ninf: isnan must stay true
OPTIONS = {"error_model": "numpy", "fastmath": FAST}
"""Of all that is compiled; `numba.extending.overload` takes them as jit_options."""


@cache
def cache_folder() -> Path:
    """Where compiled kernels of exactly these sources are kept between processes."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        text = source.read_bytes()
        if b"surrofe2.compilation" in text:
            digest.update(text)
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    base = Path(home) if home else Path.home() / ".cache"
    return base / "surrofe2" / digest.hexdigest()[:16]


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with options of one's own, cached here."""
    options = {"cache": True} | OPTIONS | options

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
