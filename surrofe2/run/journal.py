"""The journal of a run: rows, samples and whole fields, and the state that carries the run on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.run.displacement_curve import DisplacementCurve

# Column of how many points of the law are beyond a bifurcation.
BEYOND = "beyond bifurcation"
# Column of how many pairs of outer sides of the tissue cross each other.
CROSSINGS = "crossings of outer sides"
_HISTORY = (
    "mean displacement", "node displacement", "force", "impulse", "position", "penetration", BEYOND,
    CROSSINGS,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Journal:
    """Rows by the name of their series, behind one another in memory with room for more.

    A journal is never changed: `written` makes a longer one in the same memory, so no interrupt
    tears it, and an older one is a mark to go back to. Rows behind a mark are then written over, so
    a caller that keeps a journal while its run continues takes a `copy`.

    Attributes:
        room: (most, …) rows by name of the series, the first of which are written.
        lengths: number of the written rows by name.
    """

    room: Mapping[str, Array]
    lengths: Mapping[str, int]

    @classmethod
    def of(cls, rows: Mapping[str, Array]) -> Journal:
        """Make a journal with the first rows (m, …) of each series, in memory of its own."""
        return cls({}, {}).written(rows)

    def written(self, rows: Mapping[str, Array]) -> Journal:
        """Return the journal with rows (m, …) of some series behind those that are there.

        Room is doubled where it is full, so that many short writings take little time.
        """
        room = dict(self.room)
        lengths = dict(self.lengths)
        for name, values in rows.items():
            if name not in room:
                room[name] = np.array(values, dtype=np.float64)
                lengths[name] = len(values)
                continue
            first = lengths[name]
            last = lengths[name] + len(values)
            if last > len(room[name]):
                larger = np.empty((2 * last, *room[name].shape[1:]))
                larger[:first] = room[name][:first]
                room[name] = larger
            room[name][first:last] = values
            lengths[name] = last
        return Journal(room, lengths)

    def __getitem__(self, name: str) -> Array:
        """Return the written rows of a series."""
        return self.room[name][: self.lengths[name]]

    def part(self, name: str) -> dict[str, Array]:
        """Return the series ``name.…`` by what follows the dot."""
        return {key: self[f"{name}.{key}"] for key in part_of(self.room, name)}

    def copy(self) -> Journal:
        """Return the same journal in memory of its own."""
        return Journal.of({name: self[name] for name in self.room})


class RunState:
    """Base of dataclasses of all that carries a run on.

    Fields are arrays, numbers, dicts of numbers, a `journal` of the series `SERIES`, and perhaps a
    `mark`, a state to go back to. `law_state` is whatever a law makes it: the caller that writes a
    file adds it by the law's own means.
    """

    __slots__ = ()
    SERIES: ClassVar[tuple[str, ...]]

    def to_arrays(self) -> dict[str, NDArray]:
        """Return one array for each entry; those of dicts are ``"counts.steps"`` and so on."""
        arrays: dict[str, NDArray] = {}
        # a subclass may add results, which are no part of the state
        kind = next(base for base in type(self).__mro__ if "SERIES" in vars(base))
        for item in fields(kind):
            value = getattr(self, item.name)
            if isinstance(value, Journal):
                arrays |= {name: value[name].copy() for name in self.SERIES}
            elif isinstance(value, RunState):
                arrays |= within(item.name, value.to_arrays())
            elif isinstance(value, dict):
                arrays |= within(item.name, {key: np.array(entry) for key, entry in value.items()})
            elif value is not None and item.name != "law_state":
                arrays[item.name] = np.array(value)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """Return the state whose `to_arrays` gave `arrays`.

        Raises:
            InputError: one of them is missing.
        """
        values: dict[str, Any] = {}
        for item in fields(cls):  # type: ignore[arg-type]
            inner = part_of(arrays, item.name)
            if item.name == "journal":
                series = {name: _entry(arrays, name) for name in cls.SERIES}
                values["journal"] = Journal.of(series)
            elif item.name in ("mark", "law_state"):
                values[item.name] = cls.from_arrays(inner) if inner else None
            elif inner:
                values[item.name] = {name: _value(array) for name, array in inner.items()}
            elif item.type in ("dict[str, int]", "dict[str, Array]"):  # with nothing in it
                values[item.name] = {}
            else:
                values[item.name] = _value(_entry(arrays, item.name))
        return cls(**values)


def within(name: str, arrays: Mapping[str, NDArray]) -> dict[str, NDArray]:
    """Return the arrays by names that begin with another and a dot."""
    return {f"{name}.{key}": values for key, values in arrays.items()}


def part_of(arrays: Mapping[str, NDArray], name: str) -> dict[str, NDArray]:
    """Return the arrays whose names `within` began with this one, by the rest of their names."""
    begin = f"{name}."
    return {k.removeprefix(begin): values for k, values in arrays.items() if k.startswith(begin)}


def _entry(arrays: Mapping[str, NDArray], name: str) -> NDArray:
    """Return an array by name; an `InputError` where it is missing."""
    if name not in arrays:
        raise InputError(f"state of a run: no {name!r}; the checkpoint is incomplete")
    return arrays[name]


def _value(array: NDArray) -> Any:
    """Return a number of an array without axes, else the array in memory of its own."""
    return array.item() if np.ndim(array) == 0 else np.array(array, dtype=np.float64)


# Series that a journal has of whole fields in any case.
FRAME_TIMES = ("frames.t", "frames.point_t")


def check_frames(journal: Journal, *, are_taken: bool) -> None:
    """Refuse to continue a journal that lacks whole fields of its frames, if new frames are kept in
    it.

    Fields of the frames that follow would stand beside the times of others.

    Args:
        are_taken: whether the continued run gives its fields away, too.
    """
    lacking = journal.lengths.get("frames.t", 0) - journal.lengths.get("frames.displacement", 0)
    if lacking and not are_taken:
        raise MismatchError(
            f"resume: keep_frame took the whole fields of {lacking} frames of the state; give "
            "keep_frame again, or start over"
        )


def frame_series(frames: Any, *, times_alone: bool = False) -> dict[str, Array]:
    """Return the rows that a dataclass of whole fields at some times adds to a journal.

    With `times_alone`, since the fields are kept elsewhere, only the times have rows.
    """
    rows = {f"frames.{item.name}": getattr(frames, item.name) for item in fields(frames)}
    if not times_alone:
        return rows
    return {name: values if name in FRAME_TIMES else values[:0] for name, values in rows.items()}


def named_columns(names: Iterable[str], rows: Array) -> dict[str, Array]:
    """Return the columns (m,) by name."""
    return dict(zip(names, rows.T, strict=True))


def curves_of(t: Array, columns: Mapping[str, Array]) -> dict[str, DisplacementCurve]:
    """Return the displacement of each watched point, of the columns ``displacement NAME x`` and
    ``y``.
    """
    begin = "displacement "
    names = [key[len(begin) : -2] for key in columns if key.startswith(begin) and key[-1] == "x"]
    return {
        name: DisplacementCurve(t, np.stack([columns[f"{begin}{name} {a}"] for a in "xy"], axis=1))
        for name in names
    }


def history_of(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the columns of boundaries, supports, loads and bodies, whose names `_HISTORY` begins.

    The count of points beyond a bifurcation is among them unless the law cannot tell and the column
    is NaN, the count of outer sides that cross only where any do.
    """
    history = {name: column for name, column in columns.items() if name.startswith(_HISTORY)}
    if np.isnan(history.get(BEYOND, 0.0)).any():
        del history[BEYOND]
    if not history.get(CROSSINGS, np.ones(1)).any():
        del history[CROSSINGS]
    return history
