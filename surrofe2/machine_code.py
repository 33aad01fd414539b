"""Machine code of a kernel that is its own: the same bits in every process, read in less time.

numba gives each kernel copies of the functions that it calls, under names that all kernels share.
Of equal names the one that comes first into a process serves all, and copies that were optimised
in different surroundings round differently: so results would depend on which kernels a process
had loaded or compiled before. Here a kernel keeps its copies to itself. And numba reads, beside a
kept kernel's machine code, the code from which other kernels could take functions, which takes
ten times as long: here that waits until one does.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import binding
from numba.core.base import BaseContext
from numba.core.codegen import JITCodeLibrary

CACHE_LINE = 64
"""Bytes."""


class OwnCode(JITCodeLibrary):
    """Machine code without names that other kernels' code could stand in for."""

    _kept: tuple[bytes, bytes] | None = None
    """Machine code and bitcode as they were read; None where it was compiled in this process."""
    _is_made = False
    """Whether there is machine code already; of what others only take copies of, none is made."""

    def _finalize_final_module(self) -> None:
        if self._kept is None:
            self._shared_module = self._final_module.clone()
            for function in _defined(self._shared_module, "external"):
                function.linkage = "linkonce_odr"
            for function in _defined(self._final_module, "linkonce_odr"):
                function.linkage = "internal"
        self._finalize_dynamic_globals()
        self._finalized = True

    def _optimize_final_module(self) -> None:
        if not self._is_wrapper:  # it is optimised with what takes a copy of it
            super()._optimize_final_module()

    @property
    def _is_wrapper(self) -> bool:
        """Whether it only calls the body of a parallel loop; numba's names for such code."""
        return self.name == "parallelgufuncwrapper" or "_GufuncWrapper" in self.name

    def _make(self) -> None:
        if not self._is_made:
            super()._finalize_final_module()
            self._is_made = True

    def serialize_using_object_code(self) -> Any:
        """Name, machine code and bitcode, to be kept."""
        self._ensure_finalized()
        self._make()
        return super().serialize_using_object_code()

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        library._kept = data
        library.enable_object_caching()
        library._set_compiled_object(data[0])
        library._finalize_final_module()
        return library

    def _get_module_for_linking(self) -> Any:
        if self._kept is not None and self._shared_module is None:
            self._shared_module = binding.parse_bitcode(self._kept[1])
        return super()._get_module_for_linking()

    def get_pointer_to_function(self, name: str) -> int:
        """Address of a function of this code; 0 where it has none of that name."""
        self._ensure_finalized()
        self._make()
        if self._kept is not None and name.encode() in self._kept[0]:
            self._codegen._engine._defined_symbols.add(name)
        return int(super().get_pointer_to_function(name))


def _defined(module: Any, linkage: str) -> Iterator[Any]:
    for function in module.functions:
        if not function.is_declaration and function.linkage.name == linkage:
            yield function


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
