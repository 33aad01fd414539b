"""How numba lays out the machine code of our kernels: aligned arrays, and names of its own.

numba gives each kernel copies of the functions that it calls, under names that all kernels share.
Of equal names the one that comes first into a process serves all, and copies that were optimised
in different surroundings round differently: results would depend on which kernels a process has
loaded or compiled before. Here a kernel keeps its copies to itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.base import BaseContext
from numba.core.codegen import JITCodeLibrary

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
