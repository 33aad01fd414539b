"""A surrogate as C source that needs the standard library alone: for any host program."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, quoted
from surrofe2.law.stress_law import Status
from surrofe2.store.store import WORD
from surrofe2.surrogate import SurrogateLaw
from surrofe2.surrogate.error_bound import REACH
from surrofe2.surrogate.features import BEND

_STATUSES = (Status.OK, Status.OUT_OF_RANGE, Status.NOT_FINITE, Status.NOT_TRUSTED)
_PER_LINE = 6

_HEAD = """\
/* Stress of plant tissue at a point: a surrogate of surrofe2 {version} in C99, self-contained.
 *
 * Units: um, us, ng; so force is uN, stress in the plane uN/um, rates 1/us.
 * Cell parameters {cell}, initialisation {initialisation}, trained on data {data}.
 * Range: U11 and U22 from {low:g} to {high:g}, |U12| up to {shear:g}, |R'F_rate| up to {rate:g}.
 *
 *   int surrofe2_stress(const double *F, const double *F_rate, double tolerance, double *stress,
 *                       double *bound, double *P_by_F, double *P_by_F_rate);
 *
 * F, F_rate: deformation gradient and its rate, F11 F12 F21 F22.
 * tolerance: largest bound of the error of the stress that is accepted, uN/um; HUGE_VAL: any.
 * stress: Cauchy stress, xx xy yx yy, NaN unless 0 is returned. bound: of its error, in the
 *     Frobenius norm; HUGE_VAL outside the data.
 * P_by_F, P_by_F_rate: 16 numbers each, P_ab by F_cd at 8 a + 4 b + 2 c + d, P the first
 *     Piola-Kirchhoff stress; both NULL: not wanted.
 * Returns SURROFE2_OK, or why there is no stress. It has no state; threads may call it at once.
 */

#include <math.h>
#include <stddef.h>
#include <string.h>

"""


def c_source(law: SurrogateLaw) -> str:
    """A surrogate as C source: value, tangents, domain and bound as in its compiled pass.

    Raises:
        InputError: a text of the surrogate is no single word, and could be more than a comment.
    """
    texts = {
        "version": law.version,
        "cell": law.cell.fingerprint,
        "initialisation": law.initialisation,
        "data": law.data_fingerprint,
    }
    for name, text in texts.items():
        if not WORD.fullmatch(text):
            raise InputError(f"{name} of the surrogate: {quoted(text)}; it must be {WORD.pattern}")
    low, high = law.range.stretch
    head = _HEAD.format(
        **texts,
        low=low,
        high=high,
        shear=law.range.shear,
        rate=law.range.rate,
    )
    lines = [f"#define SURROFE2_{status.name} {int(status)}" for status in _STATUSES]
    body = files("surrofe2.store").joinpath("surrogate_body.c").read_text(encoding="utf-8")
    return head + "\n".join([*lines, "", *_tables(law), "", body])


def _tables(law: SurrogateLaw) -> Iterator[str]:
    """Sizes and arrays of a surrogate, as its kernels read them."""
    network, bounds = law.arrays, law.bound_arrays
    sizes = {
        "PRODUCTS": len(network.products),
        "INVARIANTS": len(network.invariants),
        "TERMS": len(network.terms),
        "LAYERS": len(network.sizes),
        "UNITS": int(network.sizes.sum()),
        "BOUNDARY": len(bounds.boundary),
        "BOUND": len(bounds.bound),
    }
    yield from (f"#define {name} {value}" for name, value in sizes.items())
    yield f"#define REACH {REACH!r}"
    yield f"#define BEND {BEND!r}"
    yield ""
    arrays = {
        "range": network.bounds,
        "input_factor": network.input_factor,
        "output_factor": network.output_factor,
        "at_rest": network.at_rest,
        "products": network.products,
        "begins": network.begins,
        "heads": network.heads,
        "group_begins": network.group_begins,
        "tails": network.tails,
        "coefficients": network.coefficients,
        "invariants": network.invariants,
        "terms": network.terms,
        "powers": network.powers,
        "sizes": network.sizes,
        "weights": network.weights,
        "biases": network.biases,
        "domain_factor": bounds.factor,
        "boundary_table": bounds.boundary_table,
        "boundary": bounds.boundary,
        "bound_table": bounds.bound_table,
        "bound_coefficients": bounds.bound,
        "near": bounds.near,
    }
    for name, values in arrays.items():
        yield from _table(name, values)


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
