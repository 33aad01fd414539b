"""A surrogate as C source that needs the standard library alone: for any host program."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from textwrap import wrap
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, quoted
from surrofe2.base.tensors import INPUTS
from surrofe2.law.stress_law import Status
from surrofe2.store.store import WORD, check_replaceable, read_bytes, write_text
from surrofe2.surrogate import SurrogateLaw
from surrofe2.surrogate.domain import ALL_INPUTS, COMPRESSION, NEAR, NORM, REACH, SQUARES
from surrofe2.surrogate.features import BEND, BENT, COMPONENTS, NETWORK_INPUTS
from surrofe2.surrogate.lookup import BoundArrays, NetworkArrays
from surrofe2.surrogate.products import ONE, STRETCH

# Pattern of the prefix of all functions.
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}")
_STATUSES = (Status.OK, Status.OUT_OF_RANGE, Status.NOT_FINITE, Status.NOT_TRUSTED)
# Points in a loop: 1 in a call for one point, 8 in a block of a batch.
_WIDTHS = (1, 8)
# The variables of formulas, see `_Formulas`.
_VARIABLE = re.compile(r"\b(?:[rdn]\d+|low|size)\b")
_SUMS = "\n            ".join(
    f"{name}[{i}] = "
    + " + ".join(f"slopes[{4 * (first + j) + i} * @L@ + l] * {of}[{j}]" for j in range(count))
    + ";"
    for name, of, first, count in (("u", "d", 0, INPUTS), ("v", "e", 3, COMPONENTS))
    for i in range(COMPONENTS)
)

# Words in the first line of every source, by which another file is told from one.
_MARK = "a surrogate of surrofe2"
_HEADER = """\
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


def c_source(law: SurrogateLaw, name: str = "surrofe2") -> str:
    """Return a surrogate as C source: value, tangents, domain and bound as in its compiled pass.

    Args:
        law: the surrogate.
        name: beginning of the functions' names, by which two surrogates link into one program.

    Raises:
        InputError: a text of the surrogate is no single word, and could be more than a comment; or
            the name is none of C.
    """
    body = files("surrofe2.store").joinpath("surrogate_body.c").read_text(encoding="utf-8")
    includes, helpers, answers, calls = body.split("@SPLIT@\n")
    lines = [c_header(law, name), includes, *_tables(law), "", helpers]
    for width in _WIDTHS:
        lines += [*_bound(law, width), *_network(law, width)]
        lines += [answers.replace("@SUMS@", _SUMS).replace("@L@", str(width))]
    return "\n".join([*lines, calls.replace("@NAME@", name)])


def write_c(law: SurrogateLaw, path: Path, name: str = "surrofe2", *, fresh: bool = False) -> str:
    """Write `c_source` into a file and `c_header` beside it, and return the source.

    Raises:
        InputError: another source is there, and not `fresh`; or the file's name ends as a header's.
        FileError: a file is there that is no source of a surrogate.
    """
    header = path.with_suffix(".h")
    if header == path:
        raise InputError(f"{path}: the header goes there; give the source another ending, .c")
    texts = {path: c_source(law, name), header: c_header(law, name)}
    # Both are checked before the first is written, so a refusal leaves nothing behind.
    for file, text in texts.items():
        if not file.exists() or read_bytes(file) == text.encode("utf-8"):
            continue
        check_replaceable(file, "C source of a surrogate", _MARK)
        if not fresh:
            raise InputError(f"{file}: another source is there; --fresh writes this one instead")
    for file, text in texts.items():
        write_text(file, text)
    return texts[path]


def c_header(law: SurrogateLaw, name: str = "surrofe2") -> str:
    """Return the header of `c_source`, which begins with it, for C and C++."""
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
    statuses = "\n".join(f"#define SURROFE2_{status.name} {int(status)}" for status in _STATUSES)
    return _HEADER.format(
        **texts,
        name=name,
        low=low,
        high=high,
        shear=law.range.shear,
        rate=law.range.rate,
        statuses=statuses,
    )


def _tables(law: SurrogateLaw) -> Iterator[str]:
    """Yield the arrays of a surrogate that loops read; its other numbers stand in formulas."""
    yield f"#define INPUTS {INPUTS}"
    yield f"#define COMPONENTS {COMPONENTS}"
    yield ""
    lower, upper = law.bound_arrays.limits
    limits = np.array([lower[0], *upper[[0, 2, 3]]])  # of U11 and U22, |U12| and |A|
    arrays = {"range": limits, "input_factor": law.arrays.input_factor}
    for k, (weight, bias) in enumerate(law.network.layers):
        units = len(bias)
        padded_weight = np.zeros((weight.shape[1], _padded(units)))
        padded_weight[:, :units] = weight.T
        padded_bias = np.zeros(_padded(units))
        padded_bias[:units] = bias
        arrays[f"weight_{k}"] = padded_weight
        arrays[f"bias_{k}"] = padded_bias
    arrays["no_bias"] = np.zeros(max(_padded(len(bias)) for _, bias in law.network.layers))
    for name, values in arrays.items():
        yield from _table(name, values)


def _padded(rows: int) -> int:
    """Return the next multiple of four: loops over units are unrolled by it."""
    return 4 * -(-rows // 4)


class _Formulas:
    """Products and polynomials as formulas in C, or their slopes along an input.

    Row k of a table is the variable rk and its slope dk, of which `by` has those that are not 0;
    `wanted` are the rows, or their slopes.

    Args:
        table: the polynomials.
        inputs: formulas of the variables of the rows before those of products, by variable, and
            of the variables in these.
        first: the row of the first product.
        along: the input along which slopes are wanted; None: no slopes.
        by: slopes of the rows before `first` along the input, where they are not 0.
    """

    def __init__(
        self,
        table: NetworkArrays | BoundArrays,
        inputs: Mapping[str, str],
        first: int,
        along: int | None = None,
        by: Mapping[int, str] = MappingProxyType({}),
    ) -> None:
        self.table = table
        self.along = along
        self.variables = dict(inputs)
        self.rows = {k: f"r{k}" for k in range(first)} | {ONE: "1.0"}
        self.by = dict(by)
        for row, (first_factor, second_factor) in enumerate(table.products.tolist(), first):
            self.rows[row] = f"r{row}"
            self.variables[f"r{row}"] = f"r{first_factor} * r{second_factor}"
            parts = []  # of the slope, by the product rule
            if first_factor in self.by:
                parts.append(_times(self.by[first_factor], f"r{second_factor}"))
            if second_factor == along:
                parts.append(f"r{first_factor}")
            if parts:
                self.by[row] = f"d{row}"
                self.variables[f"d{row}"] = " + ".join(parts)
        self.wanted = self.rows if along is None else self.by

    def polynomial(self, number: int) -> str:
        """Return the formula of one of the polynomials, or of its slope."""
        table = self.table
        sums = []
        for group in range(table.begins[number], table.begins[number + 1]):
            head = int(table.heads[group])
            factors = [(self.rows[head], self.wanted)]
            if head == self.along:  # the slope of the head is 1
                factors.append(("1.0", self.rows))
            for factor, rows in factors:
                terms = []
                for k in range(table.group_begins[group], table.group_begins[group + 1]):
                    row = int(table.rows[k])
                    if row in rows:
                        terms.append(_times(rows[row], _number(table.coefficients[k])))
                if terms:
                    sums.append(_times(factor, f"({' + '.join(terms)})"))
        return " + ".join(sums) or "0.0"

    def loop(self, lines: Sequence[str], width: int) -> Iterator[str]:
        """Yield a loop over points, with the variables that its lines need."""
        names = set(_VARIABLE.findall(" ".join(lines)))
        declared = []
        # backwards: a variable needs only those before it
        for name, value in reversed(self.variables.items()):
            if name in names:
                declared.append(f"const double {name} = {value};")
                names.update(_VARIABLE.findall(value))
        yield f"    for (int l = 0; l < {width}; l++) {{"
        for line in [*reversed(declared), *lines]:
            yield from wrap(
                line, 100, initial_indent=" " * 8, subsequent_indent=" " * 12,
                break_long_words=False, break_on_hyphens=False,
            )  # fmt: skip
        yield "    }"


def _times(first: str, second: str) -> str:
    """Return the formula of a product; a factor of 1 is left out."""
    if first == "1.0":
        return second
    if second == "1.0":
        return first
    return f"{first} * {second}"


def _bound(law: SurrogateLaw, width: int) -> Iterator[str]:
    """Yield the function that computes failure boundary and bound from the inputs."""
    bounds = law.bound_arrays
    squares = [f"r{SQUARES + k}" for k in range(INPUTS)]
    inputs = {f"r{k}": f"x[{k * width} + l] * {_number(bounds.factor[k])}" for k in range(INPUTS)}
    inputs |= {square: f"r{k} * r{k}" for k, square in enumerate(squares)}
    shares = [f"{_number(bounds.near[k])} * {square}" for k, square in enumerate(squares)]
    inputs |= {
        "low": "r0 < 0.0 ? r0 : 0.0",
        f"r{COMPRESSION}": "low * low",
        f"r{NORM}": f"({' + '.join(squares)}) * {1.0 / INPUTS!r}",
        "size": " + ".join(shares),
        f"r{NEAR}": f"size / (size + {REACH!r})",
    }
    formulas = _Formulas(bounds, inputs, ALL_INPUTS)
    lines = [f"height[l] = {formulas.polynomial(0)};", f"bound[l] = {formulas.polynomial(1)};"]
    yield f"static void bound_of_{width}(const double *RESTRICT x, double *RESTRICT height,"
    yield "                       double *RESTRICT bound)"
    yield "{"
    yield "    (void)x; /* where there is no bound, nothing is read */"
    yield from formulas.loop(lines, width)
    yield "}"
    yield ""


def _network(law: SurrogateLaw, width: int) -> Iterator[str]:
    """Yield the function that computes the components of RᵀP, and their slopes, from inputs."""
    layers = [weight.shape for weight, _ in law.network.layers]
    invariants = law.arrays.kept[len(law.arrays.components) :].tolist()
    sizes = [layers[0][1], *(_padded(rows) for rows, _ in layers)]
    yield f"static void network_of_{width}(const double *RESTRICT x, double *RESTRICT y,"
    yield "                         int with_slopes, double *RESTRICT slopes)"
    yield "{"
    for name in ("u", "v"):  # units of each layer, and their slopes
        arrays = ", ".join(f"{name}{k}[{size * width}]" for k, size in enumerate(sizes))
        yield f"    double {arrays};"
    inputs = {f"r{k}": f"x[{k * width} + l]" for k in range(INPUTS)}
    for k in range(STRETCH):  # the inputs bent, r/√(B² + r²), and their slopes B²/(B² + r²)^(3/2)
        inputs |= {
            f"n{k}": f"inverse_root({BEND * BEND!r} + r{k} * r{k})",
            f"r{BENT + k}": f"r{k} * n{k}",
            f"d{BENT + k}": f"{BEND * BEND!r} * n{k} * n{k} * n{k}",
        }
    for along in (None, *range(INPUTS)):  # the components, or their slopes along an input
        by = {} if along is None else {along: "1.0"}
        if along is not None and along < STRETCH:
            by[BENT + along] = f"d{BENT + along}"
        formulas = _Formulas(law.arrays, inputs, NETWORK_INPUTS, along, by)
        if along is None:
            result = "y"
            units = "u"
            first = 0
        else:
            result = "slopes"
            units = "v"
            first = along * COMPONENTS
        lines = [
            f"{result}[{(first + k) * width} + l] = {formulas.polynomial(k)};"
            for k in range(COMPONENTS)
        ]
        read = [formulas.wanted.get(row, "0.0") for row in invariants]
        used = [k for k, value in enumerate(read) if value != "0.0"]
        lines += [f"{units}0[{k * width} + l] = {read[k]};" for k in used]
        yield from formulas.loop(lines, width)
        for k, shape in enumerate(layers):
            names = f"weight_{k}, {f'bias_{k}' if along is None else 'no_bias'}"
            yield f"    LAYER({width}, {names}, {sizes[k + 1]}, {units}{k + 1},"
            for j in range(shape[1]) if k else used:  # the others of the first layer are 0
                yield f"        TERM({width}, weight_{k}, {j}, {units}{k})"
            yield "    );"
            size = sizes[k + 1] * width
            if k < len(layers) - 1 and along is None:
                yield f"    FILL_TANH(u{k + 1}, {size});"
            elif k < len(layers) - 1:
                yield f"    TIMES_TANH_SLOPE(v{k + 1}, u{k + 1}, {size});"
        yield from formulas.loop(list(_terms(law, width, formulas)), width)
        if along is None:
            yield "    if (!with_slopes)"
            yield "        return;"
    yield "}"
    yield ""


def _terms(law: SurrogateLaw, width: int, formulas: _Formulas) -> Iterator[str]:
    """Yield lines that add (factor − factor at rest) × product to components, or its slope."""
    network = law.arrays
    last = len(law.network.layers)
    along = formulas.along
    # `kept` has the rows of the terms first, then those of the invariants
    terms = zip(network.components.tolist(), network.kept.tolist(), strict=False)
    for k, (component, row) in enumerate(terms):
        place = f"[{k * width} + l]"
        scale = _number(network.output_factor[component])
        factor = f"(u{last}{place} - {_number(network.at_rest[k])})"
        product = formulas.rows[row]
        if along is None:
            yield f"y[{component * width} + l] += {scale} * {_times(factor, product)};"
            continue
        rise = _times(f"v{last}{place}", product)
        if row in formulas.by:
            rise += f" + {_times(factor, formulas.by[row])}"
        yield f"slopes[{(along * COMPONENTS + component) * width} + l] += {scale} * ({rise});"


def _table(name: str, values: NDArray[Any]) -> Iterator[str]:
    """Yield an array (n,) or (n, m) in C, with all digits."""
    sizes = "".join(f"[{size}]" for size in values.shape)
    yield f"static const double {name}{sizes} = {{"
    for row in values.tolist():
        if isinstance(row, list):
            yield f"    {{{', '.join(map(_number, row))}}},"
        else:
            yield f"    {_number(row)},"
    yield "};"


def _number(value: float) -> str:
    """Write a number in C, with all digits."""
    value = float(value)  # a file may hold truths
    if value == np.inf:
        return "HUGE_VAL"
    if value == -np.inf:
        return "-HUGE_VAL"
    return repr(value)
