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


# Lanes as a type of numba, and operations that emit instructions of LLVM for them. Functions called
# `generate` or `lower` are what numba calls to do so: they get LLVM's builder, the types of the
# call as `sig`, and its arguments as values of LLVM.

# without reassoc, so that sums over lanes keep their order, and their bits
_FLAGS = tuple(sorted(FAST - {"reassoc"}))
_Indices: Any = types.StarArgTuple  # type: ignore[attr-defined]
_DOUBLES = ir.VectorType(ir.DoubleType(), TILE)
_SINGLES = ir.VectorType(ir.FloatType(), TILE)
# Bytes by which loads and stores may rely on arrays to be aligned: those of any float.
_ALIGNMENT = 4


class LanesType(types.Type):
    """numba's type of a `Lanes` value."""

    def __init__(self) -> None:
        super().__init__(name=f"Lanes{TILE}")


LANES = LanesType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    """Model of a `Lanes` value in machine code: a vector of LLVM."""

    def __init__(self, manager: Any, numba_type: Any) -> None:
        super().__init__(manager, numba_type, _DOUBLES)


def _spread(builder: Any, scalar: Any) -> Any:
    """Emit a vector with one float in every lane."""
    first = builder.insert_element(
        ir.Constant(_DOUBLES, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
    )
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), TILE), [0] * TILE)
    return builder.shuffle_vector(first, ir.Constant(_DOUBLES, ir.Undefined), zeros)


def _as_lanes(builder: Any, sig: Any, args: Any) -> list[Any]:
    """Return the arguments of a call as vectors; floats are spread over all lanes."""
    vectors = []
    for kind, value in zip(sig.args, args, strict=True):
        vectors.append(value if kind is LANES else _spread(builder, value))
    return vectors


def _operator(symbol: Any, method: str) -> None:
    """Define an operator between lanes, or lanes and a float, by a method of LLVM's builder."""
    pairs = ((LANES, LANES), (LANES, types.float64), (types.float64, LANES))

    class Typing(ConcreteTemplate):
        """Types of operands that numba accepts; the result is lanes."""

        cases = [signature(LANES, *pair) for pair in pairs]  # noqa: RUF012 numba reads it so

    infer_global(symbol)(Typing)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        first, second = _as_lanes(builder, sig, args)
        return getattr(builder, method)(first, second, flags=_FLAGS)

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
    """The type of unary minus: of lanes it is lanes."""

    cases = [signature(LANES, LANES)]  # noqa: RUF012 numba reads it so


@lower_builtin(operator.neg, LANES)
def _lower_neg(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Emit unary minus."""
    return builder.fneg(args[0], flags=_FLAGS)


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Emit the address of array[index, 0], as a pointer to the element type."""
    view = context.make_array(array_type)(context, builder, array)
    zero = context.get_constant(types.intp, 0)
    return cgutils.get_item_pointer(
        context, builder, array_type, view, [*index, zero], wraparound=False
    )


def _check(array: Any, index: Any) -> None:
    """Raise a typing error unless `array` has one axis, that of the lanes, behind those indexed."""
    if not isinstance(array, types.Array) or array.ndim != len(index) + 1 or array.layout != "C":
        raise numba.TypingError(f"lanes need a contiguous array with {len(index) + 1} axes")


def _indices(context: Any, builder: Any, index_type: Any, index: Any) -> list[Any]:
    """Emit indices of any integer type as those of the machine's own."""
    return [
        context.cast(builder, value, kind, types.intp)
        for value, kind in zip(cgutils.unpack_tuple(builder, index), index_type, strict=True)
    ]


@intrinsic
def load(typing: Any, array: Any, *index: Any) -> Any:
    """Return the lanes of array[index]; single precision is widened."""
    _check(array, index)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        array_type, index_type = sig.args
        indices = _indices(context, builder, index_type, args[1])
        pointer = _pointer(context, builder, array_type, args[0], indices)
        kind = _SINGLES if array_type.dtype is types.float32 else _DOUBLES
        value = builder.load(builder.bitcast(pointer, kind.as_pointer()), align=_ALIGNMENT)
        return builder.fpext(value, _DOUBLES) if kind is _SINGLES else value

    return LANES(array, _Indices(index)), generate


@intrinsic
def store(typing: Any, value: Any, array: Any, *index: Any) -> Any:
    """Set array[index] = value, lanes or a float for all of them; it may narrow precision."""
    _check(array, index)

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value_type, array_type, index_type = sig.args
        indices = _indices(context, builder, index_type, args[2])
        pointer = _pointer(context, builder, array_type, args[1], indices)
        lanes = args[0] if value_type is LANES else _spread(builder, args[0])
        if array_type.dtype is types.float32:
            lanes = builder.fptrunc(lanes, _SINGLES)
        vector_pointer = builder.bitcast(pointer, lanes.type.as_pointer())
        builder.store(lanes, vector_pointer, align=_ALIGNMENT)
        return context.get_dummy_value()

    kind = LANES if value is LANES else types.float64
    return types.void(kind, array, _Indices(index)), generate


@intrinsic
def spread(typing: Any, scalar: Any) -> Any:
    """Return lanes with a float in every one of them."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _spread(builder, args[0])

    return LANES(types.float64), generate


def _square_root(builder: Any, value: Any, kind: Any) -> Any:
    """Emit LLVM's square root of a vector, `_DOUBLES` or `_SINGLES`."""
    suffix = f"v{TILE}f{32 if kind is _SINGLES else 64}"
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(kind, [kind]), f"llvm.sqrt.{suffix}"
    )
    return builder.call(function, [value])


@intrinsic
def root(typing: Any, value: Any) -> Any:
    """Return the square root of lanes."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _square_root(builder, args[0], _DOUBLES)

    return LANES(LANES), generate


@intrinsic
def inverse_root(typing: Any, value: Any) -> Any:
    """Return 1/√x to a few units in the last place, for x within single precision's range.

    A single-precision estimate and two Newton steps y ← y (3 − x y²)/2: cheaper than a division
    and a square root in double precision.
    """

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        number = args[0]
        single = _square_root(builder, builder.fptrunc(number, _SINGLES), _SINGLES)
        one = ir.Constant(_SINGLES, [1.0] * TILE)
        y = builder.fpext(builder.fdiv(one, single), _DOUBLES)
        half = ir.Constant(_DOUBLES, [0.5] * TILE)
        three_halves = ir.Constant(_DOUBLES, [1.5] * TILE)
        half_x = builder.fmul(half, number)
        fused = ("contract",)  # multiplication and addition may become one instruction
        for _ in range(2):
            square = builder.fmul(y, y, flags=fused)
            product = builder.fmul(half_x, square, flags=fused)
            factor = builder.fsub(three_halves, product, flags=fused)
            y = builder.fmul(y, factor)
        return y

    return LANES(LANES), generate


@intrinsic
def where_less(typing: Any, left: Any, right: Any, yes: Any, no: Any) -> Any:
    """Return `yes` in the lanes where left < right, else `no`; each lanes or a float.

    Where one of the two is NaN, it is `no`.
    """

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        first, second, if_less, otherwise = _as_lanes(builder, sig, args)
        return builder.select(builder.fcmp_ordered("<", first, second), if_less, otherwise)

    kinds = [LANES if kind is LANES else types.float64 for kind in (left, right, yes, no)]
    return LANES(*kinds), generate


@intrinsic
def any_less(typing: Any, left: Any, right: Any) -> Any:
    """Return whether left < right in any lane; each lanes or a float."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        first, second = _as_lanes(builder, sig, args)
        # the comparison is a bit for each lane: together an integer, which is 0 if none holds
        integer = ir.IntType(TILE)
        bits = builder.bitcast(builder.fcmp_ordered("<", first, second), integer)
        return builder.icmp_unsigned("!=", bits, ir.Constant(integer, 0))

    kinds = [LANES if kind is LANES else types.float64 for kind in (left, right)]
    return types.boolean(*kinds), generate


# without nnan and ninf, so that NaN stays NaN; without reassoc, so that the split of ln 2 holds
_OPTIONS = {"fastmath": {"nsz", "contract"}, "error_model": "numpy"}


@intrinsic
def _float_of_bits(context: Any, bits: Any) -> Any:
    """Return the float64 whose bits are those of an int64."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], ir.DoubleType())

    return types.float64(types.int64), generate


@intrinsic
def _bits_of_float(context: Any, number: Any) -> Any:
    """Return the bits of a float64 as an int64."""

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
_EXPONENT_BIAS = 1023
_EXPONENT_BIT = 52  # exponent k of a float64 is k + 1023, from bit 52 on


@compiled(**_OPTIONS)
def _tanh(y: float) -> float:
    """Return tanh y = 1 − 2/(e^2y + 1), with e^2y = 2^k e^r, k an integer and |r| ≤ ½ ln 2.

    e^r is a polynomial, 2^k is written into the exponent bits: no branch, no call, no table, so
    that loops become SIMD instructions. The absolute error is below 1e-15; of NaN it is NaN.
    """
    z = 2.0 * y
    z = _MOST if z > _MOST else z
    z = -_MOST if z < -_MOST else z
    shifted = z * _LOG2_E + _TO_INTEGER  # k in its low bits
    r = z - (shifted - _TO_INTEGER) * _LN2
    # e^r = 1 + r + r² q(r), by Horner's rule
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
    e *= _float_of_bits((_bits_of_float(shifted) + _EXPONENT_BIAS) << _EXPONENT_BIT)
    t = 1.0 - 2.0 / (e + 1.0)
    return t if y == y else y  # only NaN differs from itself, and stays NaN


@compiled(**_OPTIONS)
def fill_tanh(y: Any) -> None:
    """Replace each of the numbers y (n,) by its tanh."""
    for k in range(y.shape[0]):
        y[k] = _tanh(y[k])
