"""A surrogate as C source that needs the standard library alone: for any host program."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, quoted
from surrofe2.law.stress_law import Status
from surrofe2.store.store import WORD
from surrofe2.surrogate import SurrogateLaw
from surrofe2.surrogate.domain import ALL_INPUTS, COMPRESSION, NEAR, NORM, REACH, SQUARES
from surrofe2.surrogate.features import BEND

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}")
"""Of the prefix of all functions."""
_STATUSES = (Status.OK, Status.OUT_OF_RANGE, Status.NOT_FINITE, Status.NOT_TRUSTED)
_PER_LINE = 6

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
    body = body.replace("@FORWARD@", "\n".join(_forward(law))).replace("@NAME@", name)
    lines = [_about(law, name), _INCLUDES, _statuses(), "", *_tables(law), "", body]
    return "\n".join(lines)


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


def _tables(law: SurrogateLaw) -> Iterator[str]:
    """Sizes and arrays of a surrogate, as its kernels read them."""
    network, bounds, terms = law.arrays, law.bound_arrays, len(law.arrays.components)
    invariants = len(network.kept) - terms
    sizes = {
        "TERMS": terms,
        "INVARIANTS": invariants,
        "READ": law.network.features.read,
        "baseline_PRODUCTS": len(network.products),
        "bound_PRODUCTS": len(bounds.products),
        "ALL_INPUTS": ALL_INPUTS,
        "COMPRESSION": COMPRESSION,
        "NORM": NORM,
        "NEAR": NEAR,
        "SQUARES": SQUARES,
        "REACH": repr(REACH),
        "BEND": repr(BEND),
    }
    yield from (f"#define {name} {value}" for name, value in sizes.items())
    yield ""
    arrays = {
        "range": network.bounds,
        "input_factor": network.input_factor,
        "output_factor": network.output_factor,
        "at_rest": network.at_rest,
        "components_of": network.components,
        "kept": network.kept,
        "powers": network.powers,
        "domain_factor": bounds.factor,
        "near": bounds.near,
    }
    for name, table in (("baseline", network), ("bound", bounds)):
        for field in ("products", "begins", "heads", "group_begins", "rows", "coefficients"):
            arrays[f"{name}_{field}"] = getattr(table, field)
    for k, (weight, bias) in enumerate(law.network.layers):
        arrays |= {f"weight_{k}": weight.T, f"bias_{k}": bias}
    for name, values in arrays.items():
        yield from _table(name, values)


def _forward(law: SurrogateLaw) -> Iterator[str]:
    """The functions that give the factors, with all sizes written out."""
    shapes = [weight.shape for weight, _ in law.network.layers]
    for slopes in (False, True):
        name = "factors_and_slopes" if slopes else "factors_of"
        inputs = "const double *u0, " + ("double d0[][LANES], " if slopes else "")
        outputs = f"double *u{len(shapes)}" + (", double slopes[][LANES]" if slopes else "")
        yield f"static void {name}({inputs}{outputs})"
        yield "{"
        for k, (rows, columns) in enumerate(shapes, 1):
            is_last = k == len(shapes)
            if not is_last:
                yield f"    double u{k}[{rows}];"
            yield f"    LAYER(weight_{k - 1}, bias_{k - 1}, {columns}, {rows}, u{k - 1}, u{k});"
            if not is_last:
                yield f"    tanh_of(u{k}, {rows});"
            if slopes:
                yield f"    double d{k}[{rows}][LANES];"
                yield f"    SLOPES(weight_{k - 1}, {columns}, {rows}, d{k - 1}, d{k});"
            if slopes and not is_last:
                yield f"    TANH_SLOPES(u{k}, {rows}, d{k});"
            if slopes and is_last:
                yield f"    memcpy(slopes, d{k}, sizeof d{k});"
        yield "}"
        yield ""


def _table(name: str, values: NDArray[Any]) -> Iterator[str]:
    """An array in C, all digits; an empty one as a single zero that nothing reads."""
    if not values.size:
        values = np.zeros((1, *values.shape[1:]), dtype=values.dtype)
    kind = "int" if values.dtype.kind == "i" else "double"
    yield f"static const {kind} {name}{''.join(f'[{n}]' for n in values.shape)} = {{"
    number = str if kind == "int" else _number
    flat = [number(value) for value in values.ravel().tolist()]
    if values.ndim == 1:
        for first in range(0, len(flat), _PER_LINE):
            yield "    " + ", ".join(flat[first : first + _PER_LINE]) + ","
    else:
        width = values.shape[1]
        for first in range(0, len(flat), width):
            yield "    {" + ", ".join(flat[first : first + width]) + "},"
    yield "};"


def _number(value: float) -> str:
    value = float(value)  # a file may hold truths
    return "HUGE_VAL" if value == np.inf else "-HUGE_VAL" if value == -np.inf else repr(value)
