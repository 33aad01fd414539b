"""tanh that the compiler can turn into SIMD instructions: no branch, no call, no table.

tanh y = 1 − 2/(e^2y + 1), with e^2y = 2^k e^r, k an integer and |r| ≤ ½ ln 2, e^r by a
polynomial and 2^k written into the exponent bits. The absolute error is below 1e-15 (float64) or
1e-6 (float32); where y is NaN so is the answer.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from surrofe2.compilation import compiled

# without nnan and ninf, so that NaN stays NaN; without reassoc, so that the split of ln 2 holds
_FLAGS = {"nsz", "contract"}
_OPTIONS = {"fastmath": _FLAGS, "error_model": "numpy"}


@intrinsic
def _float_of_bits(context: Any, bits: Any) -> Any:
    """The float64 (or float32) whose bits are those of an int64 (or int32)."""
    result, double = {
        types.int64: (types.float64, True),
        types.int32: (types.float32, False),
    }[bits]

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], ir.DoubleType() if double else ir.FloatType())

    return result(bits), generate


@intrinsic
def _bits_of_float(context: Any, number: Any) -> Any:
    """The bits of a float64 as an int64."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.bitcast(values[0], ir.IntType(64))

    return types.int64(types.float64), generate


# (e^r − 1 − r)/r², interpolated where a Chebyshev polynomial of degree 10 is 0: to 2e-17 of e^r
_Q0, _Q1, _Q2, _Q3, _Q4, _Q5, _Q6, _Q7, _Q8, _Q9 = (
    0.5000000000000001,
    0.16666666666666669,
    0.04166666666662413,
    0.008333333333330062,
    0.0013888888917213717,
    0.00019841269863053618,
    2.4801521295954376e-05,
    2.7557268459997064e-06,
    2.7620088445409746e-07,
    2.510038549551032e-08,
)
_LOG2_E = 1.0 / math.log(2.0)
_LN2 = math.log(2.0)  # its rounding shifts y by 1e-16 of itself
_TO_INTEGER = 1.5 * 2.0**52  # added to a number it leaves its nearest integer in the low bits
_MOST = 40.0  # tanh 20 is 1 to the last bit


def _tanh64(y: Any) -> Any:
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


_S = np.float32
_S2, _S3, _S4, _S5, _S6, _S7 = (_S(1.0 / math.factorial(k)) for k in range(2, 8))
_S_LOG2_E, _S_LN2_HIGH, _S_LN2_LOW = _S(_LOG2_E), _S(0.693359375), _S(-2.12194440e-4)
_S_HALF, _S_ONE, _S_TWO, _S_MOST = _S(0.5), _S(1.0), _S(2.0), _S(40.0)


def _tanh32(y: Any) -> Any:
    z = _S_TWO * y
    z = _S_MOST if z > _S_MOST else z
    z = -_S_MOST if z < -_S_MOST else z
    k = np.floor(z * _S_LOG2_E + _S_HALF)
    r = (z - k * _S_LN2_HIGH) - k * _S_LN2_LOW
    e = _S7 * r + _S6
    e = e * r + _S5
    e = e * r + _S4
    e = e * r + _S3
    e = e * r + _S2
    e = (e * r + _S_ONE) * r + _S_ONE
    e *= _float_of_bits(np.int32((np.int32(k) + 127) << 23))
    t = _S_ONE - _S_TWO / (e + _S_ONE)
    return t if y == y else y


def vector_tanh(y: Any) -> Any:
    """tanh y for compiled code: float64, or float32 where y is."""
    return np.tanh(y)


@overload(vector_tanh, jit_options=_OPTIONS)
def _choose(y: Any) -> Any:
    return _tanh32 if y == types.float32 else _tanh64


@compiled(**_OPTIONS)
def fill_tanh(y: Any) -> None:
    """Replace every row of y (rows, points) by its tanh."""
    for row in range(y.shape[0]):
        for point in range(y.shape[1]):
            y[row, point] = vector_tanh(y[row, point])
