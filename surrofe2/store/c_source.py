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


def c_source(law: SurrogateLaw, name: str = "surrofe2") -> str:
    """A surrogate as C source: value, tangents, domain and bound as in its compiled pass.

    Args:
        name: that the functions' names begin with, so that two surrogates link into one program.

    Raises:
        InputError: a text of the surrogate is no single word, and could be more than a comment; or
            the name is none of C.
    """
    about, _, includes, helpers, answers, calls = _template(law, name)
    widths = [answers.replace("@L@", str(width)) for width in _WIDTHS]
    return "\n".join([about + includes, *_constants(law), "", helpers, *widths, calls])


def c_header(law: SurrogateLaw, name: str = "surrofe2") -> str:
    """The header of `c_source`, for C and C++."""
    about, header, *_ = _template(law, name)
    return about + header


def _template(law: SurrogateLaw, name: str) -> list[str]:
    """The parts of surrogate.c: head, header, includes, helpers, answers, calls."""
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
    bounds = {"low": low, "high": high, "shear": law.range.shear, "rate": law.range.rate}
    texts |= {what: f"{value:g}" for what, value in bounds.items()}
    codes = (f"#define SURROFE2_{status.name} {int(status)}" for status in _STATUSES)
    texts |= {"name": name, "statuses": "\n".join(codes)}
    template = files("surrofe2.store").joinpath("surrogate.c").read_text(encoding="utf-8")
    for what, text in texts.items():
        template = template.replace(f"@{what.upper()}@", text)
    return template.split("@SPLIT@\n")


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
