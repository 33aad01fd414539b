"""Eight plant cells in one register: a vector type for numba kernels.

A `Lanes` value holds one number for each of the `TILE` cells of a tile and becomes a SIMD vector
of the machine. Arrays with the lanes last are read and written whole::

    array[i, j, 0..7]  ⇄  load(array, i, j), store(array, i, j, value)      (also with one index
                                                                             or three before)

``+ - * /`` and unary minus work between lanes, and between lanes and a float. Plain loops over
lanes leave the compiler to prove that arrays do not overlap; here a whole vector is read before
another is written. Of many points, `pack` makes tiles; arrays of one tile lack the first index::

    x[tile, axis, particle, lane]    axis: 0, 1    particle: own 0..n-1, then images

At the end: a tanh without branches for plain arrays, which the compiler vectorises by itself.
"""

from __future__ import annotations

import math
import operator
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model
from numpy.typing import NDArray

from surrofe2.base.arrays import Index
from surrofe2.base.compilation import FAST, compiled

TILE = 8


def tiles_for(points: int) -> int:
    """Return the number of tiles that hold `points` points."""
    return -(-points // TILE)


def pack(values: NDArray[Any]) -> NDArray[Any]:
    """Pack (n, …) into (tiles, …, TILE); copies of the last point fill up the last tile."""
    n = len(values)
    if n % TILE:
        values = values[np.minimum(np.arange(tiles_for(n) * TILE), n - 1)]
    tiles = values.reshape(-1, TILE, *values.shape[1:])
    return np.ascontiguousarray(tiles.transpose(0, *range(2, tiles.ndim), 1))


def unpack(tiles: NDArray[Any], points: int) -> NDArray[Any]:
    """Unpack (tiles, …, TILE) into (n, …); the inverse of `pack`."""
    lanes = tiles.transpose(0, tiles.ndim - 1, *range(1, tiles.ndim - 1))
    return np.ascontiguousarray(lanes.reshape(-1, *lanes.shape[2:])[:points])


def take_points(tiles: NDArray[Any], index: Index) -> NDArray[Any]:
    """Return the points `index` of packed `tiles`, packed."""
    return pack(tiles[index // TILE, ..., index % TILE])


def put_points(tiles: NDArray[Any], index: Index, part: NDArray[Any], row: Index) -> None:
    """Overwrite the points `index` of packed `tiles` by the points `row` of packed `part`."""
    tiles[index // TILE, ..., index % TILE] = part[row // TILE, ..., row % TILE]


_FLAGS = tuple(sorted(FAST - {"reassoc"}))
_Indices: Any = types.StarArgTuple  # type: ignore[attr-defined]
_DOUBLES = ir.VectorType(ir.DoubleType(), TILE)
_SINGLES = ir.VectorType(ir.FloatType(), TILE)


class LanesType(types.Type):
    """numba's type of a `Lanes` value."""

    def __init__(self) -> None:
        super().__init__(name=f"Lanes{TILE}")


LANES = LanesType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, numba_type: Any) -> None:
        super().__init__(manager, numba_type, _DOUBLES)


def _spread(builder: Any, scalar: Any) -> Any:
    """One float in every lane."""
    first = builder.insert_element(
        ir.Constant(_DOUBLES, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
    )
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), TILE), [0] * TILE)
    return builder.shuffle_vector(first, ir.Constant(_DOUBLES, ir.Undefined), zeros)


def _operator(symbol: Any, method: str) -> None:
    pairs = ((LANES, LANES), (LANES, types.float64), (types.float64, LANES))

    class Typing(ConcreteTemplate):
        cases = [signature(LANES, *pair) for pair in pairs]  # noqa: RUF012 numba reads it so

    infer_global(symbol)(Typing)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        left, right = (
            value if kind is LANES else _spread(builder, value)
            for kind, value in zip(sig.args, args, strict=True)
        )
        return getattr(builder, method)(left, right, flags=_FLAGS)

    for pair in pairs:
        lower_builtin(symbol, *pair)(lower)


for _symbol, _method in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
    (operator.iadd, "fadd"),
    (operator.isub, "fsub"),
    (operator.imul, "fmul"),
):
    _operator(_symbol, _method)


@infer_global(operator.neg)
class _NegTyping(ConcreteTemplate):
    cases = [signature(LANES, LANES)]  # noqa: RUF012 numba reads it so


@lower_builtin(operator.neg, LANES)
def _lower_neg(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fneg(args[0], flags=_FLAGS)


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Address of array[index, 0], with the vector's element type."""
    view = context.make_array(array_type)(context, builder, array)
    zero = context.get_constant(types.intp, 0)
    return cgutils.get_item_pointer(
        context, builder, array_type, view, [*index, zero], wraparound=False
    )


def _check(array: Any, index: Any) -> None:
    if not isinstance(array, types.Array) or array.ndim != len(index) + 1 or array.layout != "C":
        raise numba.TypingError(f"lanes need a contiguous array with {len(index) + 1} axes")


def _indices(context: Any, builder: Any, index_type: Any, index: Any) -> list[Any]:
    return [
        context.cast(builder, value, kind, types.intp)
        for value, kind in zip(cgutils.unpack_tuple(builder, index), index_type, strict=True)
    ]


@intrinsic
def load(typing: Any, array: Any, *index: Any) -> Any:
    """Lanes of array[index]; single precision is widened."""
    _check(array, index)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        where = _indices(context, builder, sig.args[1], args[1])
        pointer = _pointer(context, builder, sig.args[0], args[0], where)
        kind = _SINGLES if sig.args[0].dtype is types.float32 else _DOUBLES
        value = builder.load(builder.bitcast(pointer, kind.as_pointer()), align=4)
        return builder.fpext(value, _DOUBLES) if kind is _SINGLES else value

    return LANES(array, _Indices(index)), generate


@intrinsic
def store(typing: Any, value: Any, array: Any, *index: Any) -> Any:
    """array[index] = value (lanes, or a float for all of them); may narrow to single precision."""
    _check(array, index)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        where = _indices(context, builder, sig.args[2], args[2])
        pointer = _pointer(context, builder, sig.args[1], args[1], where)
        lanes = args[0] if sig.args[0] is LANES else _spread(builder, args[0])
        if sig.args[1].dtype is types.float32:
            lanes = builder.fptrunc(lanes, _SINGLES)
        builder.store(lanes, builder.bitcast(pointer, lanes.type.as_pointer()), align=4)
        return context.get_dummy_value()

    kind = LANES if value is LANES else types.float64
    return types.void(kind, array, _Indices(index)), generate


@intrinsic
def spread(typing: Any, scalar: Any) -> Any:
    """A float in every lane."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _spread(builder, args[0])

    return LANES(types.float64), generate


def _square_root(builder: Any, value: Any, kind: Any) -> Any:
    suffix = f"v{TILE}f{32 if kind is _SINGLES else 64}"
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(kind, [kind]), f"llvm.sqrt.{suffix}"
    )
    return builder.call(function, [value])


@intrinsic
def root(typing: Any, value: Any) -> Any:
    """Square root."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _square_root(builder, args[0], _DOUBLES)

    return LANES(LANES), generate


@intrinsic
def inverse_root(typing: Any, value: Any) -> Any:
    """1/√x to a few units in the last place, for x within single precision's range.

    A single-precision estimate and two Newton steps y ← y (3 − x y²)/2: cheaper than a division
    and a square root in double precision.
    """

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        number = args[0]
        single = _square_root(builder, builder.fptrunc(number, _SINGLES), _SINGLES)
        one = ir.Constant(_SINGLES, [1.0] * TILE)
        y = builder.fpext(builder.fdiv(one, single), _DOUBLES)
        half, three_halves = (ir.Constant(_DOUBLES, [c] * TILE) for c in (0.5, 1.5))
        half_x = builder.fmul(half, number)
        for _ in range(2):
            square = builder.fmul(y, y, flags=("contract",))
            error = builder.fsub(
                three_halves, builder.fmul(half_x, square, flags=("contract",)), flags=("contract",)
            )
            y = builder.fmul(y, error)
        return y

    return LANES(LANES), generate


@intrinsic
def where_less(typing: Any, left: Any, right: Any, yes: Any, no: Any) -> Any:
    """`yes` in the lanes where left < right, else `no`; each lanes or a float."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        left, right, yes, no = (
            value if kind is LANES else _spread(builder, value)
            for kind, value in zip(sig.args, args, strict=True)
        )
        return builder.select(builder.fcmp_ordered("<", left, right), yes, no)

    kinds = [LANES if kind is LANES else types.float64 for kind in (left, right, yes, no)]
    return LANES(*kinds), generate


@intrinsic
def any_less(typing: Any, left: Any, right: Any) -> Any:
    """Return whether left < right in any lane; each lanes or a float."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        left, right = (
            value if kind is LANES else _spread(builder, value)
            for kind, value in zip(sig.args, args, strict=True)
        )
        lanes = ir.IntType(TILE)
        bits = builder.bitcast(builder.fcmp_ordered("<", left, right), lanes)
        return builder.icmp_unsigned("!=", bits, ir.Constant(lanes, 0))

    kinds = [LANES if kind is LANES else types.float64 for kind in (left, right)]
    return types.boolean(*kinds), generate


# without nnan and ninf, so that NaN stays NaN; without reassoc, so that the split of ln 2 holds
_OPTIONS = {"fastmath": {"nsz", "contract"}, "error_model": "numpy"}


@intrinsic
def _float_of_bits(context: Any, bits: Any) -> Any:
    """The float64 whose bits are those of an int64."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], ir.DoubleType())

    return types.float64(types.int64), generate


@intrinsic
def _bits_of_float(context: Any, number: Any) -> Any:
    """The bits of a float64 as an int64."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], ir.IntType(64))

    return types.int64(types.float64), generate


# (e^r − 1 − r)/r², interpolated where a Chebyshev polynomial of degree 10 is 0: to 2e-17 of e^r
_Q0 = 0.5000000000000001
_Q1 = 0.16666666666666669
_Q2 = 0.04166666666662413
_Q3 = 0.008333333333330062
_Q4 = 0.0013888888917213717
_Q5 = 0.00019841269863053618
_Q6 = 2.4801521295954376e-05
_Q7 = 2.7557268459997064e-06
_Q8 = 2.7620088445409746e-07
_Q9 = 2.510038549551032e-08
_LOG2_E = 1.0 / math.log(2.0)
_LN2 = math.log(2.0)  # its rounding shifts y by 1e-16 of itself
_TO_INTEGER = 1.5 * 2.0**52  # added to a number it leaves its nearest integer in the low bits
_MOST = 40.0  # tanh 20 is 1 to the last bit


@compiled(**_OPTIONS)
def _tanh(y: float) -> float:
    """1 − 2/(e^2y + 1), with e^2y = 2^k e^r, k an integer and |r| ≤ ½ ln 2.

    e^r is a polynomial, 2^k is written into the exponent bits: no branch, no call, no table, so
    that loops become SIMD instructions. The absolute error is below 1e-15; of NaN it is NaN.
    """
    z = 2.0 * y
    z = _MOST if z > _MOST else z
    z = -_MOST if z < -_MOST else z
    shifted = z * _LOG2_E + _TO_INTEGER
    r = z - (shifted - _TO_INTEGER) * _LN2
    q = _Q9 * r + _Q8
    q = q * r + _Q7
    q = q * r + _Q6
    q = q * r + _Q5
    q = q * r + _Q4
    q = q * r + _Q3
    q = q * r + _Q2
    q = q * r + _Q1
    q = q * r + _Q0
    e = (q * r + 1.0) * r + 1.0
    e *= _float_of_bits((_bits_of_float(shifted) + 1023) << 52)
    t = 1.0 - 2.0 / (e + 1.0)
    return t if y == y else y


@compiled(**_OPTIONS)
def fill_tanh(y: Any) -> None:
    """Replace each of the numbers y (n,) by its tanh."""
    for k in range(y.shape[0]):
        y[k] = _tanh(y[k])
