"""Settings are frozen dataclasses whose fields say unit, meaning and bounds once.

@dataclass(frozen=True, slots=True, kw_only=True)
class TableSettings:
    tolerance: float = setting(1e-3, "largest error of a stress", above=0.0, below=1.0)

    def __post_init__(self) -> None:
        check_settings(self, "table")
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import MISSING, field, fields
from functools import cache
from operator import attrgetter
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from surrofe2.base.errors import InputError, quoted, shortened
from surrofe2.base.units import NONE

T = TypeVar("T")

_LONGEST_NAME, _LONGEST_LIST = 60, 150
"""Characters of a name and of a list of names in a sentence."""
REMOVED: dict[str, str] = {
    "training.form": "leave it out; the network always gives the whole stress",
    "training.energy_hidden": "leave it out; the network always gives the whole stress",
    "table.enabled": "leave it out; --law cached asks RVEs where the surrogate may not answer, and "
    "--law table learns from them",
    "calibration.states": "leave it out; random states, corners and small states are parts of the "
    "walks now",
    "calibration.corners": "leave it out; a quarter of the walks end in corners",
    "calibration.small": "leave it out; a quarter of the walks stay near rest",
    "calibration.share": "call it calibration.alpha",
}
"""Keys that recipes had in earlier versions, as "section.key", and what to do instead."""
_SMALLEST, _LARGEST, _ENDS = 1e-60, 1e30, (0.0, math.inf, -math.inf)
"""Numbers beyond these are mistakes, whose products overflow."""


def setting(default: Any = MISSING, about: str = "", unit: str = NONE, **bounds: Any) -> Any:
    """A field of a settings dataclass.

    Args:
        bounds: of numbers, also those in a list: `least`, `most`, `above`, `below`, and `inf=True`
            where infinity is allowed; of a text: `one_of`. Other entries are kept as metadata.
    """
    return field(default=default, metadata={"about": about, "unit": unit, **bounds})


def check_settings(settings: Any, section: str) -> None:
    """Check types and bounds of all fields made by `setting`; integers become the floats, lists
    the tuples they are.

    Raises:
        InputError: naming section, field, value and what is allowed.
    """
    hints = hints_of(settings.__class__)
    for item in fields(settings):
        if item.metadata:
            given = attrgetter(item.name)(settings)
            value = check_value(f"{section}.{item.name}", given, hints[item.name], item.metadata)
            object.__setattr__(settings, item.name, value)


def from_table(
    section: str, kind: type[T], table: Mapping[str, Any], extras: Iterable[str] = ()
) -> T:
    """The settings that the entries of a section state.

    Args:
        extras: keys that the section has besides the fields, which are not among the entries.

    Raises:
        InputError: naming the entry that is unknown, missing or not what it must be.
    """
    check_entries(section, kind, table, extras)
    return kind(**table)


def check_entries(
    section: str, kind: type, table: Mapping[str, Any], extras: Iterable[str] = ()
) -> None:
    """Refuse entries of a section that no settings can be made of, as of `from_table`."""
    items = {item.name: item for item in fields(kind)}
    hints = hints_of(kind)
    known = [*items, *extras]
    for key, value in table.items():
        if f"{section}.{key}" in REMOVED:
            raise InputError(f"{section}.{key}: removed; {REMOVED[f'{section}.{key}']}")
        if key not in items:
            raise InputError(unknown(f"{section}.{key}", key, "key", known))
        if items[key].metadata:
            check_value(f"{section}.{key}", value, hints[key], items[key].metadata)
    for item in items.values():
        required = item.default is MISSING and item.default_factory is MISSING
        if required and item.name not in table:
            unit = item.metadata.get("unit", NONE)
            told = f"{section}.{item.name}: missing; it must be given"
            raise InputError(told if unit == NONE else f"{told} ({unit})")


def unknown(name: str, key: str, what: str, known: Iterable[str]) -> str:
    """The sentence that refuses a key which is not among the known."""
    close = difflib.get_close_matches(key, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    names = shortened(", ".join(sorted(known)), _LONGEST_LIST)
    return f"{shortened(name, _LONGEST_NAME)}: unknown {what}; {hint}known are {names}"


@cache
def hints_of(kind: Hashable) -> dict[str, Any]:
    """Types of a dataclass's fields by name."""
    return get_type_hints(kind)


def check_value(name: str, value: Any, hint: Any, bounds: Mapping[str, Any]) -> Any:
    """The value as its type has it.

    Args:
        name: whose value it is, for the sentence.
        hint: its type: float, int, bool, str, Literal, a tuple or Mapping of these, or one of
            them or None.
        bounds: as `setting` takes them.

    Raises:
        InputError: it is of another type or out of its bounds.
    """
    options = get_args(hint)
    if NoneType in options:
        inner = next(option for option in options if option is not NoneType)
        return None if value is None else check_value(name, value, inner, bounds)
    if get_origin(hint) is tuple:
        return _list(name, value, options, bounds)
    if get_origin(hint) is Mapping:
        if not isinstance(value, Mapping):
            raise _refusal(name, value, "a table of entries", bounds)
        own = options[1] in (str, float, int)
        return {k: check_value(f"{name}.{k}", v, options[1], {}) if own else v
                for k, v in value.items()}  # fmt: skip
    if hint in (float, int):
        return _number(name, value, hint, bounds)
    one_of = options if get_origin(hint) is Literal else bounds.get("one_of", ())
    if one_of and value not in one_of:
        raise _refusal(name, value, f"one of {', '.join(map(str, one_of))}", {})
    if not one_of and not isinstance(value, hint):
        raise _refusal(name, value, "true or false" if hint is bool else "a text in quotes", bounds)
    return value


def _list(name: str, value: Any, options: tuple[Any, ...], bounds: Mapping[str, Any]) -> Any:
    endless = options[-1] is Ellipsis
    if not isinstance(value, tuple | list) or not (endless or len(value) == len(options)):
        allowed = "a list" if endless else f"a list of {len(options)}"
        raise _refusal(name, value, allowed, bounds)
    kinds = options[:1] * len(value) if endless else options
    entries = enumerate(zip(value, kinds, strict=True))
    return tuple(check_value(f"{name}[{k}]", entry, kind, bounds) for k, (entry, kind) in entries)


def _number(name: str, value: Any, kind: type, bounds: Mapping[str, Any]) -> Any:
    numeric = isinstance(value, int if kind is int else int | float)
    if not numeric or isinstance(value, bool):
        raise _refusal(name, value, "an integer" if kind is int else "a number", bounds)
    least, most = bounds.get("least", -math.inf), bounds.get("most", math.inf)
    above, below = bounds.get("above"), bounds.get("below")
    inside = (above is None or value > above) and (below is None or value < below)
    if not (_is_finite(value, bounds) and inside and least <= value <= most):
        raise _refusal(name, value, allowed_numbers(kind, bounds), {})
    if kind is float and not (_SMALLEST <= abs(value) <= _LARGEST or value in _ENDS):
        raise _refusal(name, value, f"0, or of {_SMALLEST:g} to {_LARGEST:g}", bounds)
    return kind(value)


def _is_finite(value: int | float, bounds: Mapping[str, Any]) -> bool:
    try:
        return math.isfinite(value) or (bounds.get("inf", False) and not math.isnan(value))
    except OverflowError:  # an integer beyond all floats
        return False


def allowed_numbers(kind: type, bounds: Mapping[str, Any]) -> str:
    """Bounds of a number in words."""
    least, most, above, below = (bounds.get(key) for key in ("least", "most", "above", "below"))
    noun = "an integer " if kind is int else ""
    if least is not None and most is not None:
        return f"{noun}from {least} to {most}" if noun else f"within [{least:g}, {most:g}]"
    if above is not None and below is not None:
        return f"between {above:g} and {below:g}"
    if least is not None:
        return f"{noun}{'of ' if noun else ''}at least {least:g}" + ("" if noun else " and finite")
    words = "positive" if above == 0 else f"above {above:g}" if above is not None else ""
    end = "" if bounds.get("inf") else "finite"
    return " and ".join(word for word in (words, end) if word) or "a number"


def _refusal(name: str, value: Any, allowed: str, metadata: Mapping[str, Any]) -> InputError:
    unit = metadata.get("unit", NONE)
    shown = quoted(list(value) if isinstance(value, tuple) else value)
    told = f"{shortened(name, _LONGEST_NAME)}: {shown}; it must be {allowed}"
    return InputError(told if unit == NONE else f"{told} ({unit})")
