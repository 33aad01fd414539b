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
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, asdict, field, fields, is_dataclass
from functools import cache
from numbers import Integral, Real
from operator import attrgetter
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from surrofe2.base.errors import FileError, InputError, Surrofe2Error, quoted, shortened
from surrofe2.base.units import NONE, with_micro_sign

T = TypeVar("T")

# Characters of a list of names in an error message.
_LONGEST_LIST = 150
# Keys that recipes had in earlier versions, as "section.key", and what to do instead.
REMOVED: dict[str, str] = {
    "training.form": "leave it out; the network always gives the whole stress",
    "training.energy_hidden": "leave it out; the network always gives the whole stress",
    "table.enabled": "leave it out; --law cached solves RVEs where the surrogate is not certain, "
    "and --law table learns from them",
    "calibration.states": "leave it out; random states, corners and small states are parts of the "
    "walks now",
    "calibration.corners": "leave it out; a quarter of the walks end in corners",
    "calibration.small": "leave it out; a quarter of the walks stay near rest",
    "samples.add": "leave it out; give harvests to `surrofe2 train --add`",
    "calibration.share": "call it calibration.alpha",
}
# Numbers beyond these, other than the ends, are mistakes, whose products overflow.
_SMALLEST = 1e-60
_LARGEST = 1e30
_ENDS = (0.0, math.inf, -math.inf)


def setting(default: Any = MISSING, about: str = "", unit: str = NONE, **bounds: Any) -> Any:
    """Make a field of a settings dataclass.

    Args:
        default: value of an entry that is left out; without one it must be given.
        about: meaning of the field, for messages and the schema.
        unit: its unit.
        bounds: for numbers, also those in a list: `least`, `most`, `above`, `below`, and `inf=True`
            where infinity is allowed; for a text: `one_of`, and `is_file=True` where it is a name
            on the disk, which stays as it is. `read` (name, entry) returns the value of an entry
            that a recipe states otherwise.
    """
    return field(default=default, metadata={"about": about, "unit": unit, **bounds})


def check_settings(settings: Any, section: str) -> None:
    """Check types and bounds of all fields made by `setting`.

    Integers become floats, and lists become tuples, where the type says so.

    Raises:
        InputError: naming section, field, value and what is allowed.
    """
    hints = hints_of(settings.__class__)
    for item in fields(settings):
        if item.metadata:
            value = attrgetter(item.name)(settings)
            value = check_value(f"{section}.{item.name}", value, hints[item.name], item.metadata)
            object.__setattr__(settings, item.name, value)


class Faults:
    """Collects the errors of entries, so that all of them are reported at once."""

    def __init__(self) -> None:
        self.errors: list[Surrofe2Error] = []

    @contextmanager
    def noted(self) -> Iterator[None]:
        """Note errors of the block, and let the work continue behind it."""
        try:
            yield
        except (FileError, InputError) as error:
            self.errors += error.faults or [error]

    def take(self, make: Callable[..., T], *args: Any) -> T:
        """Return the result of a call; None where it fails, and `check` will raise."""
        with self.noted():
            return make(*args)
        return None  # type: ignore[return-value, unused-ignore]

    def check(self) -> None:
        """Raise the first of the errors, with all of them as its `faults`."""
        if self.errors:
            first = self.errors[0]
            first.faults = tuple(self.errors)
            raise first


def build(
    kind: Callable[..., T],
    table: Any,
    where: str,
    extras: Iterable[str] = (),
    of: type | None = None,
    **fixed: Any,
) -> T:
    """Build the settings that the entries of a table state; entries may be tables themselves.

    Args:
        kind: the dataclass, or a function that makes it of its fields; `dict` returns these alone.
        where: dotted name of the table.
        extras: keys that it may have besides, which are read elsewhere.
        of: the dataclass, where `kind` is none.
        fixed: fields that are no entries.

    Raises:
        InputError: an entry is unknown, missing or not what it must be; `faults` has all of them.
    """
    check_table(where, table)
    form: Any = of or kind
    items = {item.name: item for item in fields(form) if item.metadata and item.name not in fixed}
    hints = hints_of(form)
    faults = Faults()
    values = dict(fixed)
    prefix = f"{where}." if where else ""
    for key, value in table.items():
        name = f"{prefix}{key}"
        with faults.noted():
            removed = REMOVED.get(f"{where.rpartition('.')[2]}.{key}")
            if removed is not None:
                raise InputError(name, f"removed; {removed}")
            if key not in items:
                raise unknown(name, key, "key", [*items, *extras])
            read = items[key].metadata.get("read")
            if read is not None:
                values[key] = read(name, value)
            else:
                values[key] = check_value(name, value, hints[key], items[key].metadata)
    for item in items.values():
        if item.default is MISSING and item.name not in table:
            unit = item.metadata["unit"]
            more = "" if unit == NONE else f" ({unit})"
            with faults.noted():
                raise InputError(f"{prefix}{item.name}", f"missing; it must be given{more}")
    faults.check()
    try:
        return kind(**values)
    except InputError as error:
        raise error.within(where) from None


def build_kind(kinds: Mapping[str, type[T]], table: Any, where: str, **fixed: Any) -> T:
    """Build the settings of a table whose entry `kind` says what it is; else as `build`."""
    check_table(where, table)
    kind = table.get("kind")
    if kind is None:
        raise InputError(f"{where}.kind", f"missing; it must be one of {', '.join(kinds)}")
    if not isinstance(kind, str) or kind not in kinds:
        shown = quoted(kind)
        raise unknown(f"{where}.kind", shown.strip("'"), "kind", kinds, f"{shown}: ")
    others = {key: value for key, value in table.items() if key != "kind"}
    return build(kinds[kind], others, where, ("kind",), **fixed)


def build_only(kinds: Mapping[str, Any], table: Any, where: str) -> Any:
    """Build the settings under the one key of a table, which says what they are.

    Raises:
        InputError: it has none of the keys, several, or another.
    """
    check_table(where, table)
    for key in table:
        if key not in kinds:
            raise unknown(f"{where}.{key}", key, "key", kinds)
    if len(table) != 1:
        keys = " and ".join(table) if table else "none of them"
        raise InputError(where, f"{keys}; it must have exactly one of {', '.join(kinds)}")
    key = next(iter(table))
    kind = kinds[key]
    entry = table[key]
    where = f"{where}.{key}"
    # a `read` that the class inherits reads its whole family, and would come here again
    if "read" in vars(kind):
        return kind.read(where, entry)
    return build(kind, entry, where)


def with_kind(settings: Any, kinds: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return kind and entries of settings; the name alone of a class that recipes do not know."""
    for name, kind in kinds.items():
        if isinstance(settings, kind):
            return name, asdict(settings)
    return type(settings).__name__, {}


def check_table(where: str, value: Any) -> None:
    """Reject an entry that is no table."""
    if not isinstance(value, Mapping):
        what = f"a section [{where}]" if where.isidentifier() else "a table of entries"
        raise InputError(where, f"{quoted(value)}; it must be {what}")


def unknown(where: str, key: str, what: str, known: Iterable[str], shown: str = "") -> InputError:
    """Return the error that rejects a key which is not among the known.

    Args:
        shown: begin of the message, where the key is the value of an entry.
    """
    close = difflib.get_close_matches(key, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    names = shortened(", ".join(sorted(known)), _LONGEST_LIST)
    return InputError(where, f"{shown}unknown {what}; {hint}known are {names}")


@cache
def hints_of(kind: Hashable) -> dict[str, Any]:
    """Return the types of a dataclass's fields by name."""
    return get_type_hints(kind)


def check_value(name: str, value: Any, hint: Any, bounds: Mapping[str, Any]) -> Any:
    """Check a value, and return it as its type has it.

    Args:
        name: name of the entry, for the message.
        hint: its type: float, int, bool, str, Literal, settings, a tuple or Mapping of these, or
            one of them or None. A class may have a function `read` (name, value) of its own.
        bounds: as `setting` takes them.

    Raises:
        InputError: it is of another type or out of its bounds.
    """
    options = get_args(hint)
    if hint is Any:
        return value
    if NoneType in options:
        inner = next(option for option in options if option is not NoneType)
        return None if value is None else check_value(name, value, inner, bounds)
    if get_origin(hint) is tuple:
        return _list(name, value, options, bounds)
    if get_origin(hint) is Mapping:
        check_table(name, value)
        faults = Faults()
        checked = {
            key: faults.take(check_value, f"{name}.{key}", entry, options[1], bounds)
            for key, entry in value.items()
        }
        faults.check()
        return checked
    if hint in (float, int):
        return _number(name, value, hint, bounds)
    if isinstance(value, str) and not bounds.get("is_file"):
        value = with_micro_sign(value)
    one_of = options if get_origin(hint) is Literal else bounds.get("one_of", ())
    if one_of and not (isinstance(value, Hashable) and value in one_of):  # an array is neither
        raise _refusal(name, value, f"one of {', '.join(map(str, one_of))}", {})
    if one_of or isinstance(value, hint):
        return value
    if hasattr(hint, "read"):
        return hint.read(name, value)
    if is_dataclass(hint):
        make: Any = hint
        return build(make, value, name)
    allowed = {bool: "true or false", str: "a text in quotes"}.get(hint, hint.__name__)
    raise _refusal(name, value, allowed, bounds)


def _list(name: str, value: Any, options: tuple[Any, ...], bounds: Mapping[str, Any]) -> Any:
    """Check a list: its length, and each entry; return a tuple.

    Args:
        options: types of its entries; one type and an ellipsis where it may be of any length.
    """
    endless = options[-1] is Ellipsis
    if not isinstance(value, tuple | list) or not (endless or len(value) == len(options)):
        allowed = "a list" if endless else f"a list of {len(options)}"
        raise _refusal(name, value, allowed, bounds)
    kinds = options[:1] * len(value) if endless else options
    entries = enumerate(zip(value, kinds, strict=True))
    return tuple(check_value(f"{name}[{k}]", entry, kind, bounds) for k, (entry, kind) in entries)


def _number(name: str, value: Any, kind: type, bounds: Mapping[str, Any]) -> Any:
    """Check a number against its bounds, and return it as an int or a float."""
    numeric = isinstance(value, Integral if kind is int else Real)  # numpy's, too
    if not numeric or isinstance(value, bool):
        raise _refusal(name, value, "an integer" if kind is int else "a number", bounds)
    least = bounds.get("least", -math.inf)
    most = bounds.get("most", math.inf)
    above = bounds.get("above")
    below = bounds.get("below")
    inside = (above is None or value > above) and (below is None or value < below)
    # comparisons, as an integer may be beyond all floats
    is_nan = value != value  # NaN alone is not equal to itself; math.isnan fails on large integers
    finite = abs(value) < math.inf or (bounds.get("inf", False) and not is_nan)
    if not (finite and inside and least <= value <= most):
        raise _refusal(name, value, allowed_numbers(kind, bounds), {})
    if kind is float and not (_SMALLEST <= abs(value) <= _LARGEST or value in _ENDS):
        raise _refusal(name, value, f"0, or of {_SMALLEST:g} to {_LARGEST:g}", bounds)
    return kind(value)


def allowed_numbers(kind: type, bounds: Mapping[str, Any]) -> str:
    """Write the bounds of a number in words."""
    least = bounds.get("least")
    most = bounds.get("most")
    above = bounds.get("above")
    below = bounds.get("below")
    noun = "an integer " if kind is int else ""
    if least is not None and most is not None:
        return f"{noun}from {least} to {most}" if noun else f"within [{least:g}, {most:g}]"
    if above is not None and below is not None:
        return f"between {above:g} and {below:g}"
    if least is not None:
        if kind is int:
            return f"an integer of at least {least:g}"
        return f"at least {least:g} and finite"
    words = ""
    if above is not None:
        words = "positive" if above == 0 else f"above {above:g}"
    end = "" if bounds.get("inf") else "finite"
    return " and ".join(word for word in (words, end) if word) or "a number"


def _refusal(name: str, value: Any, allowed: str, metadata: Mapping[str, Any]) -> InputError:
    """Make the error that rejects a value and says what is allowed."""
    unit = metadata.get("unit", NONE)
    shown = quoted(list(value) if isinstance(value, tuple) else value)
    problem = f"{shown}; it must be {allowed}"
    return InputError(name, problem if unit == NONE else f"{problem} ({unit})")
