"""A surrogate as C source that needs the standard library alone: for any host program."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, quoted
from surrofe2.base.tensors import INPUTS
from surrofe2.law.stress_law import Status
from surrofe2.store.store import WORD
from surrofe2.surrogate import SurrogateLaw
from surrofe2.surrogate.domain import ALL_INPUTS, COMPRESSION, NEAR, NORM, REACH, SQUARES
from surrofe2.surrogate.features import BEND, COMPONENTS
from surrofe2.surrogate.products import ONE, STRETCH

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}")
"""Of the prefix of all functions."""
_STATUSES = (Status.OK, Status.OUT_OF_RANGE, Status.NOT_FINITE, Status.NOT_TRUSTED)
_PER_LINE = 6
_WIDTHS = (1, 8)  # points in a loop: of a call for one point, and of a block of a batch
_UNUSED = ("bounds_kept", "bounds_at_rest")
"""Arrays that C does not read: its bound is in µN/µm."""

_ABOUT = """\
/* Stress of plant tissue at a point: a surrogate of surrofe2 {version} in C99, self-contained.
 *
 * Units: um, us, ng; so force is uN, stress in the plane uN/um, rates 1/us.
 * Cell parameters {cell}, initialisation {initialisation}, trained on data {data}.
 * Range: U11 and U22 from {low:g} to {high:g}, |U12| up to {shear:g}, |R'F_rate| up to {rate:g}.
 *
 * F, F_rate: deformation gradient and its rate, F11 F12 F21 F22.
 * tolerance: largest bound of the error of the stress that is accepted, uN/um; HUGE_VAL: any.
 * stress: Cauchy stress, xx xy yx yy, NaN unless 0 is returned. bound: of its error, in the
 *     Frobenius norm; HUGE_VAL outside the data.
 * P_by_F, P_by_F_rate: 16 numbers each, P_ab by F_cd at 8 a + 4 b + 2 c + d, P the first
 *     Piola-Kirchhoff stress; both NULL: not wanted.
 * {name}_stress returns SURROFE2_OK, or why there is no stress.
 * {name}_stress_of does the same at `count` points, one after the other in arrays, and returns
 *     how many have no stress. Neither has a state; threads may call them at once.
 */
"""
_HEADER = """
#ifndef SURROFE2_{name}_H
#define SURROFE2_{name}_H

#include <stddef.h>

{statuses}

#ifdef __cplusplus
extern "C" {{
#endif

int {name}_stress(const double *F, const double *F_rate, double tolerance, double *stress,
                  double *bound, double *P_by_F, double *P_by_F_rate);
size_t {name}_stress_of(size_t count, const double *F, const double *F_rate, double tolerance,
                        double *stress, double *bound, double *P_by_F, double *P_by_F_rate,
                        int *status);

#ifdef __cplusplus
}}
#endif

#endif
"""
_INCLUDES = """
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
#define RESTRICT
#else
#define RESTRICT restrict
#endif
"""


def c_source(law: SurrogateLaw, name: str = "surrofe2") -> str:
    """A surrogate as C source: value, tangents, domain and bound as in its compiled pass.

    Args:
        name: that the functions' names begin with, so that two surrogates link into one program.

    Raises:
        InputError: a text of the surrogate is no single word, and could be more than a comment; or
            the name is none of C.
    """
    body = files("surrofe2.store").joinpath("surrogate_body.c").read_text(encoding="utf-8")
    helpers, answers, calls = body.split("@SPLIT@\n")
    about = [_about(law, name), _INCLUDES, _statuses(), "", *_constants(law), "", helpers]
    widths = [answers.replace("@L@", str(width)) for width in _WIDTHS]
    return "\n".join([*about, *widths, calls.replace("@NAME@", name)])


def c_header(law: SurrogateLaw, name: str = "surrofe2") -> str:
    """The header of `c_source`, for C and C++."""
    return _about(law, name) + _HEADER.format(name=name, statuses=_statuses())


def _statuses() -> str:
    return "\n".join(f"#define SURROFE2_{status.name} {int(status)}" for status in _STATUSES)


def _about(law: SurrogateLaw, name: str) -> str:
    texts = {
        "version": law.version,
        "cell": law.cell.fingerprint,
        "initialisation": law.initialisation,
        "data": law.data_fingerprint,
    }
    for what, text in texts.items():
        if not WORD.fullmatch(text):
            raise InputError(f"{what} of the surrogate: {quoted(text)}; it must be {WORD.pattern}")
    if not NAME.fullmatch(name):
        raise InputError(f"name: {quoted(name)}; it must be a name in C, {NAME.pattern}")
    low, high = law.range.stretch
    return _ABOUT.format(
        **texts, name=name, low=low, high=high, shear=law.range.shear, rate=law.range.rate
    )


def _constants(law: SurrogateLaw) -> Iterator[str]:
    """Sizes, and the arrays of a surrogate that its kernels read."""
    network, bounds, terms = law.arrays, law.bound_arrays, len(law.arrays.components)
    for name, value in {
        "INPUTS": INPUTS,
        "COMPONENTS": COMPONENTS,
        "STRETCH": STRETCH,
        "ONE": ONE,
        "BEND": BEND,
        "TERMS": terms,
        "INVARIANTS": len(network.kept) - terms,
        "LAYERS": len(network.sizes) - 1,
        "UNITS": network.sizes.sum(),
        "NETWORK_ROWS": ONE + 1 + len(network.products),
        "COMPRESSION": COMPRESSION,
        "NORM": NORM,
        "NEAR": NEAR,
        "SQUARES": SQUARES,
        "REACH": REACH,
        "BOUND_INPUTS": ALL_INPUTS,
        "BOUND_ROWS": ALL_INPUTS + len(bounds.products),
    }.items():
        yield f"#define {name} {value}"
    arrays = {f"network_{name}": values for name, values in network._asdict().items()}
    arrays |= {f"bounds_{name}": values for name, values in bounds._asdict().items()}
    # by columns, so that rows of one column lie together for the loops in C
    begins = np.cumsum([0, *network.sizes[1:] * network.sizes[:-1]]).tolist()
    arrays["network_weights"] = np.concatenate(
        [
            network.weights[first:last].reshape(-1, columns).T.ravel()
            for first, last, columns in zip(begins, begins[1:], network.sizes, strict=False)
        ]
    )
    for name, values in arrays.items():
        if name not in _UNUSED:
            yield from _array(name, values)


def _array(name: str, values: NDArray[Any]) -> Iterator[str]:
    """An array in C, all digits; an empty one as a single zero that nothing reads."""
    kind, number = ("int", str) if values.dtype.kind == "i" else ("double", _number)
    flat = [number(value) for value in values.ravel().tolist()] or ["0"]
    yield f"static const {kind} {name}[{len(flat)}] = {{"
    for first in range(0, len(flat), _PER_LINE):
        yield "    " + ", ".join(flat[first : first + _PER_LINE]) + ","
    yield "};"


def _number(value: float) -> str:
    value = float(value)  # a file may hold truths
    return "HUGE_VAL" if value == np.inf else "-HUGE_VAL" if value == -np.inf else repr(value)
