"""Machine code of kernels: made once, and with no names that others share.

numba compiles a function and all functions that it calls one by one. The code of each is copied
into the code of those that call it, and numba makes machine code of it at every level, for all of
them could be called from Python. A loop over all cores adds three such levels. Here machine code is
made where something asks for its address: of the outermost function.

numba gives each kernel copies of the functions that it calls, under names that all kernels share.
Of equal names the one that comes first into a process serves all, and copies that were optimised
in different surroundings round differently: results would depend on which kernels a process has
loaded or compiled before. Here a kernel keeps its copies to itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite.binding import parse_bitcode
from numba import _dynfunc
from numba.core.base import BaseContext
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.cpu import CPUContext

# Bytes of a line of the processor's cache.
CACHE_LINE = 64

# Words in numba's names of the code that it makes about the body of a loop over all cores.
_ABOUT_LOOPS = ("__numba_parfor_gufunc", "_GufuncWrapper", "parallelgufuncwrapper")
# The functions that are being compiled, as numba's dispatchers, each called by the one before.
# numba compiles under a lock, so there is one such list for all threads.
_under_way: list[Any] = []
# Environments of the functions compiled meanwhile, by the name of the variable that points to them.
_environments: list[tuple[str, Any]] = []


class KernelCode(JITCodeLibrary):
    """The code of a function, for other functions to copy, and machine code once it is asked for.

    numba calls the methods that begin with an underscore.
    """

    _shared_module: Any
    _has_machine_code = False
    # the code, as LLVM's bitcode, of a library that the cache has kept with its machine code
    _kept_code = b""

    def _optimize_final_module(self) -> None:
        """Optimise the code, unless it is of a loop's body, which is optimised with the kernel.

        All others are optimised before they are copied, too. Without that, compilation would take
        a third less, but the last digits of stresses would change.
        """
        if not _is_of_loop_body(self.name):
            super()._optimize_final_module()

    def _finalize_final_module(self) -> None:
        """Make the code ready to be copied into that of other functions."""
        if self._shared_module is None and not self._kept_code:
            self._shared_module = self._final_module.clone()
            _relink(self._shared_module, "external", "linkonce_odr")
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> Any:
        """Return the address of a function in machine code, 0 if there is none of this name."""
        self._ensure_finalized()
        if not self._has_machine_code:
            self._has_machine_code = True
            _relink(self._final_module, "linkonce_odr", "internal")
            super()._finalize_final_module()
        return super().get_pointer_to_function(name)

    def serialize_using_object_code(self) -> Any:
        """Return what the cache keeps: code alone, or machine code, code and the names in it."""
        if not self._has_machine_code:
            return self.name, "bitcode", self._final_module.as_bitcode()
        name, kind, (machine_code, code) = super().serialize_using_object_code()
        return name, kind, (machine_code, code, _defined_names(self._shared_module))

    @classmethod
    def _unserialize(cls, codegen: Any, kept: Any) -> KernelCode:
        """Return the library of which the cache keeps this."""
        name, kind, data = kept
        if kind == "bitcode":
            return super()._unserialize(codegen, kept)
        library = codegen.create_library(name)
        machine_code, library._kept_code, names = data
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        codegen._engine._defined_symbols.update(names)
        return library

    def _get_module_for_linking(self) -> Any:
        """Return the code for another function to copy.

        Kept code is read here, since hardly any function that has machine code is copied.
        """
        if self._shared_module is None and self._kept_code:
            self._shared_module = parse_bitcode(self._kept_code)
        return super()._get_module_for_linking()


def _defined_names(module: Any) -> list[str]:
    """Return the names of the functions and variables that a module defines."""
    all_values = [*module.functions, *module.global_variables]
    return [value.name for value in all_values if not value.is_declaration]


def _relink(module: Any, before: str, after: str) -> None:
    """Change the linkage of the functions of a module that have this one."""
    for function in module.functions:
        if not function.is_declaration and function.linkage.name == before:
            function.linkage = after


def _is_of_loop_body(name: str) -> bool:
    """Tell whether code of this name is a part of a kernel: a loop's body, or numba's about it."""
    if any(word in name for word in _ABOUT_LOOPS):
        return True
    dispatcher = _under_way[-1]
    is_own_code = name == dispatcher.py_func.__qualname__
    return is_part() and dispatcher.is_loop_body and is_own_code


def is_part() -> bool:
    """Tell whether the function that is being compiled is called by another one that is, too.

    Python cannot call it then: it has no machine code of its own.
    """
    return len(_under_way) > 1


@contextmanager
def kernel_code(dispatcher: Any) -> Iterator[None]:
    """Compile or read a function, in the block, as `KernelCode`; other people's stay as they are.

    Arrays that it makes begin at a line of the processor's cache: of others, numbers of eight lanes
    lie across two, and solves of RVEs take up to a fifth longer, by chance.
    """
    _under_way.append(dispatcher)
    try:
        if is_part():
            yield
        else:
            with _replaced_in_numba(dispatcher.targetctx.codegen()):
                yield
    finally:
        _under_way.pop()


@contextmanager
def _replaced_in_numba(codegen: Any) -> Iterator[None]:
    """Put what is defined here into numba, in the block."""
    usual_class = codegen._library_class
    usual_alignment = BaseContext.get_preferred_array_alignment
    codegen._library_class = KernelCode
    BaseContext.get_preferred_array_alignment = lambda *_: CACHE_LINE
    CPUContext.get_executable = _executable
    JITCPUCodegen.set_env = _note_environment
    try:
        yield
    finally:
        codegen._library_class = usual_class
        BaseContext.get_preferred_array_alignment = usual_alignment
        CPUContext.get_executable = _usual_executable
        JITCPUCodegen.set_env = _usual_set_env
        for name, environment in _environments:
            # the optimiser drops variables that nothing uses
            if codegen._engine.get_global_value_address(name):
                codegen.set_env(name, environment)
        _environments.clear()


_usual_executable = CPUContext.get_executable
_usual_set_env = JITCPUCodegen.set_env


def _executable(context: Any, library: Any, description: Any, environment: Any) -> Any:
    """Return the function that Python calls, or a stand-in where Python cannot call it.

    The arguments are those of numba's `get_executable`, which would ask for the address.
    """
    if _may_be_called(description):
        return _usual_executable(context, library, description, environment)
    module = description.lookup_module()
    name = description.qualname.split(".")[-1]
    address = 0  # it has no machine code
    _environments.append((context.get_env_name(description), environment))
    return _dynfunc.make_function(module, name, "", address, environment, (library,))


def _may_be_called(description: Any) -> bool:
    """Tell whether Python may call a function that is compiled: the outermost one, and users' own.

    It never calls kernels that other kernels call, see `is_part`, nor numba's own functions and
    bodies of loops.
    """
    compiled = [(each.py_func.__module__, each.py_func.__qualname__) for each in _under_way]
    name = (description.modname, description.qualname)
    is_of_numba = description.modname.startswith(("numba.", "<dynamic>"))
    return name == compiled[0] or not (name in compiled or is_of_numba)


def _note_environment(codegen: Any, name: str, environment: Any) -> None:
    """Note the environment of a function, whose variable is there once machine code is."""
    _environments.append((name, environment))
