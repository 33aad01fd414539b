"""Eight numbers at once as one value of compiled code: one SIMD register, or two, or four.

    v = load(rows, row, first)         rows[row, first : first + LANES]
    v = filled(number)                 the number in every lane
    v + w, v - w, v * w, larger(v, w)  lane by lane; `larger` is v where v > w, else w
    store(rows, row, first, v)

The compiler keeps such values in registers from load to store, which it does not do with rows
that a loop over points writes and reads again. Rows are contiguous, float64 or float32; nothing
is tested. For kernels of `surrofe2.compilation`, whose digest counts this file by that name.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

LANES = 8
BLOCK = 5 * LANES
"""Points that kernels take at once: the length of their rows."""

_INDEX = ir.IntType(32)


class Lanes(types.Type):
    """The type of `LANES` numbers of one precision."""

    def __init__(self, number: Any) -> None:
        self.number = number
        super().__init__(name=f"Lanes({number})")


@register_model(Lanes)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        number = ir.DoubleType() if lanes.number == types.float64 else ir.FloatType()
        super().__init__(manager, lanes, ir.VectorType(number, LANES))


def _address(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    """Pointer to LANES numbers of an array from (row, first) on."""
    kinds = signature.args
    array = context.make_array(kinds[0])(context, builder, values[0])
    row, first = (
        context.cast(builder, value, kind, types.intp)
        for value, kind in zip(values[1:3], kinds[1:3], strict=True)
    )
    stride = cgutils.unpack_tuple(builder, array.strides)[0]
    begin = cgutils.pointer_add(builder, array.data, builder.mul(row, stride))
    pointer = builder.gep(begin, [first])
    return builder.bitcast(pointer, context.get_value_type(Lanes(kinds[0].dtype)).as_pointer())


@intrinsic
def load(typing: Any, rows: Any, row: Any, first: Any) -> Any:
    """rows[row, first : first + LANES]."""
    result = Lanes(rows.dtype)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = _address(context, builder, signature, values)
        return builder.load(pointer, align=rows.dtype.bitwidth // 8)

    return result(rows, row, first), generate


@intrinsic
def store(typing: Any, rows: Any, row: Any, first: Any, lanes: Any) -> Any:
    """Write lanes to rows[row, first : first + LANES]."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = _address(context, builder, signature, values)
        builder.store(values[3], pointer, align=rows.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(rows, row, first, lanes), generate


@intrinsic
def filled(typing: Any, number: Any) -> Any:
    """The number in every lane."""
    result = Lanes(number)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kind = context.get_value_type(result)
        nothing = ir.Constant(kind, ir.Undefined)
        first = builder.insert_element(nothing, values[0], ir.Constant(_INDEX, 0))
        everywhere = ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES)
        return builder.shuffle_vector(first, nothing, everywhere)

    return result(number), generate


@intrinsic
def larger(typing: Any, one: Any, other: Any) -> Any:
    """`one` in lanes where it is greater, else `other`."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">", *values), *values)

    return one(one, other), generate


def _define(symbol: Callable[[Any, Any], Any], instruction: str) -> None:
    @intrinsic
    def apply(typing: Any, one: Any, other: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return getattr(builder, instruction)(*values)

        return one(one, other), generate

    def both(one: Any, other: Any) -> Any:
        return apply(one, other)

    @overload(symbol)
    def choose(one: Any, other: Any) -> Any:
        return both if isinstance(one, Lanes) and one == other else None


_define(operator.add, "fadd")
_define(operator.sub, "fsub")
_define(operator.mul, "fmul")
