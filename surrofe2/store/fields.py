"""Fields over time as XDMF + HDF5, which ParaView opens: of elements, particles, or law points.

The mesh, and what never changes on it, is in one file; each frame, all values at one time, is in a
file of its own, written as it comes. A frame is whole or absent and carries a checksum, and XDMF
names the frames that are there: a run under way can be looked at, and memory does not grow with
them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import FileError
from surrofe2.base.units import ENERGY, LENGTH, NONE, RATE, STRESS, VELOCITY
from surrofe2.run.loop import CheckpointClock
from surrofe2.store.hdf5 import Kind, Stored, Template, read, reading, write
from surrofe2.store.store import read_text, remove, write_bytes, write_text

if TYPE_CHECKING:
    from surrofe2.macro.history import Frames
    from surrofe2.rve.particles import Particles
    from surrofe2.tissue.simulation import ParticleFrames

# Values at one time by name: numbers (n,), vectors (n, 2) or tensors (n, 2, 2).
Values = Mapping[str, NDArray[Any]]
# Values over time by name: numbers (m, n), vectors (m, n, 2) or tensors (m, n, 2, 2).
Series = Mapping[str, NDArray[Any]]
# Names of the values in the files; their ends tell the unit.
F_NAME = "deformation_gradient"
F_DOT_NAME = "deformation_rate_1_per_us"
STRESS_NAME = "cauchy_stress_uN_per_um"
SOURCE_NAME = "stress_source"
BEYOND_NAME = "beyond_bifurcation"
RISK_NAME = "risk"
DISPLACEMENT_NAME = "displacement_um"
VELOCITY_NAME = "velocity_um_per_us"
PRESSURE_NAME = "fluid_pressure_MPa"
CELL = "plant_cell"
# Fields of nodes; all others are of elements.
MOTION = (DISPLACEMENT_NAME, VELOCITY_NAME)
# Units by the end of a name; the first end that fits counts.
_UNITS = {
    "_um_per_us": VELOCITY,
    "_uN_per_um": STRESS,
    "_1_per_us": RATE,
    "_pJ_per_um2": f"{ENERGY}/µm²",
    "_MPa": "MPa",
    "_um": LENGTH,  # last, since names of stresses and energies end so, too
}
# Names that fields of runs have in Python.
_SHORT = {"cauchy_stress": "stress", "deformation_gradient": "F", "deformation_rate": "F_dot"}
_TENSORS = (STRESS_NAME, F_NAME, F_DOT_NAME)
# Files of HDF5: the mesh with what does not change, and one frame with "Node" or "Cell" by name.
FIELDS_FILE = Kind("fields", 2)
FRAME_FILE = Kind("frame", 1, {"centres": dict})
# Name of the files of elements or particles.
FIELDS = "fields"
# Name of the files of points of the law.
POINTS = "points"
# Name of the files of plant cells.
PLANT_CELLS = "plant-cells"
# The folder of the frames of all of them.
FRAMES = "frames"
# Bytes and seconds of frames that wait to be written together: small ones come quickly.
_MOST_WAITING = 4e6
_LONGEST_WAIT = 2.0
# The beginning of the time of a frame in XDMF.
_TIME = "<Time Value="
# Names in XDMF of cells of so many points; those of six have the middles of their sides.
_KINDS = {1: "Polyvertex", 2: "Polyline", 3: "Triangle", 4: "Quadrilateral", 6: "Triangle_6"}


def fields_of_elements(frames: Frames, k: int = 0) -> tuple[Values, Values]:
    """Return the values of nodes and of elements at the k-th of the frames, by name."""
    at_nodes = {DISPLACEMENT_NAME: frames.displacement[k], VELOCITY_NAME: frames.velocity[k]}
    in_elements = {
        STRESS_NAME: frames.stress[k],
        F_NAME: frames.F[k],
        F_DOT_NAME: frames.F_dot[k],
        **invariants(frames.stress[k]),
        SOURCE_NAME: frames.source[k],
        RISK_NAME: frames.risk[k],
        BEYOND_NAME: frames.beyond[k],
        "dissipated_energy_pJ_per_um2": frames.dissipated[k],
    }
    return at_nodes, in_elements


def element_writer(
    folder: Path, nodes: Array, elements: NDArray[np.integer], cell: Array | None = None
) -> FrameWriter:
    """Return the writer of fields.xdmf: a mesh in µm with values of its nodes and elements.

    Args:
        nodes: (n, 2) µm.
        elements: (e, 4) quadrilaterals or (e, 6) triangles with the middles of their sides.
        cell: (e,) number of each element's plant cell, where there are several.
    """
    in_cells = {} if cell is None else {CELL: np.asarray(cell, np.float64)}
    return FrameWriter(folder, nodes, elements, in_cells=in_cells)


def write_fields(
    folder: Path,
    nodes: Array,
    elements: NDArray[np.integer],
    frames: Frames,
    cell: Array | None = None,
) -> None:
    """Write fields.xdmf of frames that are in memory; see `element_writer`."""
    with element_writer(folder, nodes, elements, cell) as writer:
        for k, t in enumerate(frames.t):
            writer.write(k, float(t), *fields_of_elements(frames, k))


def invariants(stress: Array) -> dict[str, Array]:
    """Compute invariants of stresses (…, 2, 2) in the plane, µN/µm, by the name of each.

    They are the pressure −(σ₁ + σ₂)/2, the stress √(σ₁² − σ₁σ₂ + σ₂²) of von Mises, free across the
    plane, and the largest shear (σ₁ − σ₂)/2.
    """
    xx = stress[..., 0, 0]
    yy = stress[..., 1, 1]
    off = stress[..., 0, 1] + stress[..., 1, 0]
    mean = 0.5 * (xx + yy)
    shear = 0.5 * np.hypot(xx - yy, off)
    return {
        "pressure_in_plane_uN_per_um": -mean,
        "von_mises_in_plane_uN_per_um": np.sqrt(mean**2 + 3.0 * shear**2),
        "largest_shear_in_plane_uN_per_um": shear,
    }


def particle_writer(
    folder: Path, position: Array, bonds: NDArray[np.integer], is_wall: Flags
) -> FrameWriter:
    """Return the writer of fields.xdmf of a tissue of particles.

    Points are particles at `position` (particles, 2) in µm, unloaded; wall springs `bonds` (b, 2)
    are lines between them; `wall` is 1 on wall particles, 0 on fluid.
    """
    wall = {"wall": np.asarray(is_wall, np.float64)}
    return FrameWriter(folder, position, bonds, at_points=wall)


def fields_of_particles(frames: ParticleFrames) -> tuple[Values, Values]:
    """Return the values of particles and of springs at the first of the frames, by name."""
    at_points = {
        DISPLACEMENT_NAME: frames.displacement[0],
        VELOCITY_NAME: frames.velocity[0],
    }
    return at_points, {}


def point_writer(folder: Path, position: Array, per_element: int) -> FrameWriter:
    """Return the writer of points.xdmf: deformation and stress at points of the law.

    Args:
        position: (n, 2) µm, the points of an element one after the other.
        per_element: number of points of an element.
    """
    number = np.arange(len(position))
    element = {"element": (number // per_element).astype(np.float64)}
    # each point is a cell of its own
    return FrameWriter(folder, position, number[:, None], POINTS, at_points=element)


def write_point_fields(
    folder: Path, position: Array, t: Array, values: Series, per_element: int
) -> None:
    """Write points.xdmf of values at times t (m,) µs that are in memory; see `point_writer`."""
    with point_writer(folder, position, per_element) as writer:
        for k, time in enumerate(t):
            now = {name: series[k] for name, series in values.items()}
            writer.write(k, float(time), now | invariants(now[STRESS_NAME]), {})


def write_series(
    folder: Path,
    points: Array,
    cells: NDArray[np.integer],
    t: Array,
    at_points: Series,
    in_cells: Series,
    name: str = FIELDS,
) -> None:
    """Write values of points (n, 2), µm, and cells (e, k) at times t (m,), all in memory."""
    with FrameWriter(folder, points, cells, name) as writer:
        for k, time in enumerate(t):
            points_now = {what: values[k] for what, values in at_points.items()}
            cells_now = {what: values[k] for what, values in in_cells.items()}
            writer.write(k, float(time), points_now, cells_now)


class Entry(NamedTuple):
    """An array that XDMF names.

    Attributes:
        place: its place, ``file:/name``.
        shape: its shape.
        dtype: type of its numbers.
        name: name of the values; empty for arrays of the mesh.
        centre: "Node" or "Cell", which the values belong to; empty for arrays of the mesh.
    """

    place: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    name: str = ""
    centre: str = ""


class FrameWriter:
    """Writes values of points and cells over time.

    NAME.h5 has the mesh and values that do not change, frames/NAME-0000.h5 and so on those that do.
    NAME.xdmf names all frames, NAME-last.xdmf the last one alone, for programs that read a single
    mesh.

    A frame that is written again replaces those behind it, as where a run goes back. A checkpoint
    may still count these: they are no longer named, but stay until `remove_surplus`. Small frames
    wait for each other; `flush` leaves none waiting. XDMF is written whole, so that of many frames
    it is seldom written: that takes at most `loop.SHARE` of the time, but for `flush` and the end.

    Args:
        points: (n, 2) positions, µm.
        cells: (e, k) points of each cell.
        name: name of the files.
        at_points: values of points that do not change, by name.
        in_cells: values of cells that do not change, by name.
    """

    def __init__(
        self,
        folder: Path,
        points: Array,
        cells: NDArray[np.integer],
        name: str = FIELDS,
        at_points: Values = MappingProxyType({}),
        in_cells: Values = MappingProxyType({}),
    ) -> None:
        self._folder = folder
        self._name = name
        self._times: list[float] = []
        self._waiting: dict[int, bytearray] = {}
        self._flushed = monotonic()
        self._naming = CheckpointClock(_LONGEST_WAIT)
        self._are_named = True
        self._has_surplus = False
        self._template: Template | None = None
        self._entries: list[Entry] = []
        self._constants = [
            Entry(f"{name}.h5:/{what}", in_space.shape, in_space.dtype, what, centre)
            for what, centre, in_space in _all_in_space(at_points, in_cells)
        ]
        self._mesh: dict[str, NDArray[Any]] = {
            "points": _in_space(points),
            "cells": np.asarray(cells, np.int64),
            **{what: in_space for what, _, in_space in _all_in_space(at_points, in_cells)},
        }

    @property
    def count(self) -> int:
        """Number of frames that were written, those that wait included."""
        return len(self._times)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Complete the files, unless an error ended the block."""
        if kind is None:
            self.close()

    def resume(self, times: Sequence[float]) -> None:
        """Continue behind the frames at these times, which an earlier process wrote.

        Other frames are removed.

        Raises:
            FileError: one of these is not there.
        """
        self._times = [*map(float, times)]
        for k in range(self.count):
            if not self._path(k).exists():
                raise FileError(f"{self._path(k)}: no such file; start over with --fresh")
        with reading(self._path(0), FRAME_FILE) as first:
            self._entries = [*_entries(first)]
        write(self._folder / f"{self._name}.h5", FIELDS_FILE, {}, self._mesh)
        self._write_names()
        self._has_surplus = True
        self.remove_surplus()

    def write(self, number: int, t: float, at_points: Values, in_cells: Values) -> None:
        """Write the frame of this number, at most the `count`; empty arrays are left out."""
        if number < self.count:
            self._go_back(number)
        arrays: dict[str, NDArray[Any]] = {"t": np.array([t])}
        centres = {}
        for what, centre, in_space in _all_in_space(at_points, in_cells):
            arrays[what] = in_space
            centres[what] = centre
        if self._template is None or not self._template.fits(arrays):
            self._template = Template(FRAME_FILE, {"centres": centres}, arrays)
            self._entries = [
                Entry(what, arrays[what].shape, arrays[what].dtype, what, centre)
                for what, centre in centres.items()
            ]
        self._waiting[number] = self._template.filled(arrays)
        self._times.append(t)
        size = sum(map(len, self._waiting.values()))
        if size > _MOST_WAITING or monotonic() - self._flushed > _LONGEST_WAIT:
            self._write_waiting()
            if self._naming.is_due():
                self._naming.write(self._write_names)

    def flush(self) -> None:
        """Write what waits, and name all."""
        self._write_waiting()
        if not self._are_named:
            self._write_names()

    def _write_waiting(self) -> None:
        """Write the frames that wait."""
        if self._waiting:
            if not self._has_mesh():
                write(self._folder / f"{self._name}.h5", FIELDS_FILE, {}, self._mesh)
            for number, content in self._waiting.items():
                write_bytes(self._path(number), memoryview(content))
            self._waiting = {}
            self._are_named = False
        self._flushed = monotonic()

    def remove_surplus(self) -> None:
        """Remove the frames behind the last one. Call it once no checkpoint counts them."""
        if self._has_surplus:
            counted = {self._path(k) for k in range(self.count)}
            for path in sorted(self._folder.glob(frame_files(self._name))):
                if path not in counted:
                    remove(path)
        self._has_surplus = False

    def close(self) -> None:
        """Write what waits, and the times of all frames, of which there will be no more."""
        self.flush()
        whole = self._mesh | {"t": np.array(self._times)}
        write(self._folder / f"{self._name}.h5", FIELDS_FILE, {}, whole)
        self._write_names()

    def _has_mesh(self) -> bool:
        """Return whether the file of the mesh has been written for these frames."""
        return self.count > len(self._waiting) and (self._folder / f"{self._name}.h5").exists()

    def _go_back(self, number: int) -> None:
        """Name the frames from this number on no longer; their files stay, to be resumed from."""
        is_named = number + len(self._waiting) < self.count
        self._waiting = {k: content for k, content in self._waiting.items() if k < number}
        del self._times[number:]
        if is_named:
            self._write_names()
            self._has_surplus = True

    def _path(self, number: int) -> Path:
        """Return the path of a frame's file."""
        return self._folder / _frame_file(self._name, number)

    def _write_names(self) -> None:
        """Write NAME.xdmf and NAME-last.xdmf of the frames that do not wait."""
        frames = [(k, t) for k, t in enumerate(self._times) if k not in self._waiting]
        mesh = [
            Entry(f"{self._name}.h5:/{what}", self._mesh[what].shape, self._mesh[what].dtype)
            for what in ("cells", "points")
        ]
        names = Names(self._name, mesh, self._constants, self._entries)
        write_text(self._folder / f"{self._name}.xdmf", names.series(frames))
        if frames:
            write_text(self._folder / f"{self._name}-last.xdmf", names.single(frames[-1][0]))
        self._are_named = True


def _frame_file(name: str, number: int) -> str:
    """Return the place of a frame in its folder."""
    return f"{FRAMES}/{name}-{number:04d}.h5"


def frame_files(name: str) -> str:
    """Return the pattern of the places of all frames of a series in its folder."""
    return f"{FRAMES}/{name}-[0-9][0-9][0-9][0-9]*.h5"


@dataclass(frozen=True, slots=True)
class Names:
    """The arrays that the XDMF of a series names: those of its mesh, and of every frame.

    Attributes:
        name: name of the series.
        mesh: its cells, then its points.
        constants: values that do not change.
        values: values of a frame, whose places are without the frame's file.
    """

    name: str
    mesh: Sequence[Entry]
    constants: Sequence[Entry]
    values: Sequence[Entry]

    def series(self, frames: Sequence[tuple[int, float]]) -> str:
        """Return the document of all frames, each by its number and time."""
        grids = "".join(
            f'<Grid Name="{k}" GridType="Uniform">\n{_TIME}"{t!r}"/>\n{self._content(k)}</Grid>\n'
            for k, t in frames
        )
        head = f'<Grid Name="{self.name}" GridType="Collection" CollectionType="Temporal">'
        return _document(f"{head}\n{grids}</Grid>\n")

    def single(self, number: int) -> str:
        """Return the document of one frame, without a time: programs for one mesh know none."""
        content = self._content(number)
        return _document(f'<Grid Name="{number}" GridType="Uniform">\n{content}</Grid>\n')

    def _content(self, number: int) -> str:
        """Return the XDMF of one frame: cells, points and values."""
        cells, points = self.mesh
        count, corners = cells.shape
        file = _frame_file(self.name, number)
        values = [entry._replace(place=f"{file}:/{entry.place}") for entry in self.values]
        return "".join(
            (
                f'<Topology TopologyType="{_KINDS[corners]}" NumberOfElements="{count}" '
                f'NodesPerElement="{corners}">{_data_item(cells)}</Topology>\n',
                f'<Geometry GeometryType="XYZ">{_data_item(points)}</Geometry>\n',
                *map(_attribute, (*values, *self.constants)),
            )
        )


def _document(grid: str) -> str:
    """Return an XDMF document with this grid."""
    return f'<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>\n{grid}</Domain></Xdmf>\n'


def _attribute(values: Entry) -> str:
    """Return the XDMF of values of nodes or cells."""
    kind = {1: "Scalar", 2: "Vector", 3: "Tensor"}[len(values.shape)]
    head = f'<Attribute Name="{values.name}" AttributeType="{kind}" Center="{values.centre}">'
    return f"{head}{_data_item(values)}</Attribute>\n"


def _data_item(array: Entry) -> str:
    """Return the XDMF that names an array in a file of HDF5."""
    number = "Int" if array.dtype.kind == "i" else "Float"
    shape = " ".join(map(str, array.shape))
    head = f'<DataItem DataType="{number}" Precision="8" Dimensions="{shape}" Format="HDF">'
    return f"{head}{array.place}</DataItem>"


def _all_in_space(at_points: Values, in_cells: Values) -> Iterator[tuple[str, str, NDArray[Any]]]:
    """Yield name, centre and values in space of all that are not empty."""
    for centre, data in (("Node", at_points), ("Cell", in_cells)):
        for what, values in data.items():
            if len(values):
                yield what, centre, _in_space(values, thickness=float(what == F_NAME))


def _entries(frame: Stored) -> Iterator[Entry]:
    """Yield the arrays of values in a stored frame."""
    for what, centre in frame.header()["centres"].items():
        item = frame.file[what]
        yield Entry(what, item.shape, item.dtype, what, str(centre))


def _in_space(values: NDArray[Any], thickness: float = 0.0) -> NDArray[Any]:
    """Return vectors (n, 2) as (n, 3), tensors (n, 2, 2) as (n, 3, 3), and numbers as they are.

    `thickness` is the third diagonal entry of tensors.
    """
    out = np.pad(values, [(0, 0)] + [(0, 1)] * (values.ndim - 1))
    if values.ndim == 3:
        out[:, 2, 2] = thickness
    return out


def add_to_elements(folder: Path, added: Series) -> None:
    """Add values (m, e) of the elements, by name, to the frames of a folder, or renew them."""
    stored = open_fields(folder)
    for k in range(stored.count):
        path = folder / _frame_file(FIELDS, k)
        header, arrays = read(path, FRAME_FILE)
        arrays |= {what: np.asarray(of[k], np.float64) for what, of in added.items()}
        header["centres"] |= dict.fromkeys(added, "Cell")
        write(path, FRAME_FILE, header, arrays)
    names = stored.names()
    frames = [*enumerate(stored.t.tolist())]
    write_text(folder / f"{FIELDS}.xdmf", names.series(frames))
    write_text(folder / f"{FIELDS}-last.xdmf", names.single(stored.count - 1))


@dataclass(frozen=True, slots=True)
class SeriesOfFrames:
    """Fields over time on the disk, which are read frame by frame.

    Attributes:
        folder: the folder of the run.
        name: name of the files.
        points: (n, 2) reference positions, µm.
        cells: (e, k) points of each element or spring.
        t: (m,) times, µs; factors of the load where it is a rest.
        constants: values by name that are the same at all times, in space.
    """

    folder: Path
    name: str
    points: Array
    cells: Index
    t: Array
    constants: dict[str, Array] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.t)

    def names(self) -> Names:
        """Return the arrays that its XDMF names."""
        with reading(self.folder / _frame_file(self.name, 0), FRAME_FILE) as first:
            values = [*_entries(first)]
        place = f"{self.name}.h5:/"
        mesh = [
            Entry(f"{place}cells", self.cells.shape, self.cells.dtype),
            Entry(f"{place}points", (len(self.points), 3), self.points.dtype),
        ]
        constants = [
            Entry(
                f"{place}{what}",
                of.shape,
                of.dtype,
                what,
                "Node" if len(of) == len(self.points) else "Cell",
            )
            for what, of in self.constants.items()
        ]
        return Names(self.name, mesh, constants, values)

    def frame(self, k: int, needed: Iterable[str], others: Iterable[str] | None = ()) -> Values:
        """Read values at the k-th time, by name.

        Args:
            k: number of the frame.
            needed: names of values that must be there.
            others: names of values that are read where they are there; None: all that are there.

        Raises:
            FileError: the frame is missing or damaged, or lacks values that are needed.
        """
        path = self.folder / _frame_file(self.name, k)
        frame_values: dict[str, Array] = {}
        with reading(path, FRAME_FILE) as frame:
            names = set(frame.header()["centres"]) | self.constants.keys()
            for what in needed:
                if what not in names:
                    raise FileError(f"{path}: no {what} in it; run it again with --fresh")
            for what in sorted(names) if others is None else (*needed, *others):
                if what not in names:
                    continue
                if what in self.constants:
                    frame_values[what] = self.constants[what]
                    continue
                axes = 2 if what in _TENSORS else int(what in MOTION)
                count = len(self.points if what in MOTION else self.cells)
                in_plane: Any = (..., *(slice(2),) * axes)
                frame_values[what] = frame.array(what, (count, *(3,) * axes))[in_plane]
        return frame_values


def open_fields(folder: Path, name: str = FIELDS) -> SeriesOfFrames:
    """Open the mesh of fields.h5, or of points.h5, and the times of the frames beside it.

    These are all that a finished run wrote, or those of a run under way so far.

    Raises:
        FileError: a file is missing or damaged.
    """
    path = folder / f"{name}.h5"
    with reading(path, FIELDS_FILE) as stored:
        points = stored.array("points", (None, 3))
        cells = stored.array("cells", (None, None), np.int64)
        if not 0 <= cells.min(initial=0) <= cells.max(initial=0) < len(points):
            raise ValueError("cells: of points that are not there")
        constants = {
            what: stored.array(what, (None,))
            for what in stored.file
            if what not in ("points", "cells", "t")
        }
        if "t" in stored.file:
            t = stored.array("t", (None,))
            if not len(t):
                raise ValueError("t: empty")
        else:
            t = np.array([*_times_so_far(folder, name)])
    if not len(t):
        raise FileError(f"{path}: no frames beside it yet")
    return SeriesOfFrames(folder, name, points[:, :2], cells, t, constants)


def _times_so_far(folder: Path, name: str) -> Iterator[float]:
    """Yield the times of the frames that XDMF names: a run that went back may have left more."""
    names = folder / f"{name}.xdmf"
    count = read_text(names).count(_TIME) if names.exists() else 0
    for number in range(count):
        with reading(folder / _frame_file(name, number), FRAME_FILE) as frame:
            yield float(frame.array("t", (1,))[0])


@dataclass(frozen=True, slots=True)
class StoredFields:
    """Fields over time, read back.

    Attributes:
        points: (n, 2) reference positions, µm.
        cells: (e, k) points of each element or spring.
        t: (m,) times, µs; factors of the load where it is a rest.
        values: values by name: numbers (m, e) and tensors (m, e, 2, 2) of cells, or of points of
            the law; displacement and velocity (m, n, 2) of points.
    """

    points: Array
    cells: Index
    t: Array
    values: dict[str, Array]

    @property
    def displacement(self) -> Array:
        """Displacement of the points, (m, n, 2) µm."""
        return self.values[DISPLACEMENT_NAME]


def read_fields(
    folder: Path,
    needed: Iterable[str],
    others: Iterable[str] | None = (),
    name: str = FIELDS,
    *,
    only: slice | int = slice(None),
) -> StoredFields:
    """Read the mesh of fields.h5, or of points.h5, and values over time, frame by frame.

    Args:
        folder: the folder of the run.
        needed: see `SeriesOfFrames.frame`.
        others: see `SeriesOfFrames.frame`.
        name: name of the files.
        only: numbers of the elements or points whose values are kept; all by default.
    """
    series = open_fields(folder, name)
    wanted = [*needed]
    more = None if others is None else [*others]
    rows: dict[str, list[Array]] = {}
    for k in range(series.count):
        for what, values in series.frame(k, wanted, more).items():
            rows.setdefault(what, []).append(np.array(values if what in MOTION else values[only]))
    over_time = {what: np.stack(values) for what, values in rows.items()}
    return StoredFields(series.points, series.cells, series.t, over_time)


def is_of_points(name: str, count: int, cells: int) -> bool:
    """Return whether a field of so many values is one of points, not of elements or springs."""
    return name in MOTION or count != cells


def split_unit(column: str) -> tuple[str, str]:
    """Return the name of a field as runs in Python have it, and its unit."""
    for ending, unit in _UNITS.items():
        if column.endswith(ending):
            name = column.removesuffix(ending)
            return _SHORT.get(name, name), unit
    return _SHORT.get(column, column), NONE


def write_rve_fields(folder: Path, seen: Particles, t: Array) -> None:
    """Write fields.xdmf, and the files that it names, of the RVE of `seen` at times t (n,), µs.

    Points are its particles as they are at the first time, with images where wall springs lead
    across its boundary; lines are the springs. A uniform fluid is in plant-cells.xdmf.
    """
    is_uniform = bool(seen.is_wall.all())
    particles = seen.position.shape[1]
    walls = int(seen.is_wall.sum())
    across = seen.bond_shift.any(axis=1)
    needed = np.column_stack([seen.bonds[across, 1], seen.bond_shift[across]])
    images, place = np.unique(needed, axis=0, return_inverse=True)
    springs = seen.bonds.copy()
    springs[across, 1] = particles + place.ravel()
    owner = np.append(np.arange(particles), images[:, 0])  # the particle of each point
    shift = np.append(np.zeros((particles, 2), np.int64), images[:, 1:], axis=0)  # in periods

    def moved(vectors: Array, step: Array) -> Array:
        """Return vectors (n, p, 2) of all points; those of images are by `step` a period more."""
        of_points: Array = vectors[:, owner] + shift @ step.swapaxes(1, 2)
        return of_points

    now = moved(seen.position, seen.F @ seen.lattice)
    pressure = np.zeros((len(t), particles))
    contact = np.zeros((len(t), particles))
    contact[:, :walls] = seen.contact_pressure
    if not is_uniform:
        pressure[:, walls:] = seen.pressure
    of_particles = np.stack([seen.is_wall[owner], (shift != 0).any(axis=1)])
    wall, image = np.broadcast_to(of_particles[:, None], (2, len(t), len(owner)))
    at_points = {
        "displacement_um": now - now[0],
        "velocity_um_per_us": moved(seen.velocity, seen.F_dot @ seen.lattice),
        "force_uN": seen.force[:, owner],
        PRESSURE_NAME: pressure[:, owner],
        "contact_pressure_MPa": contact[:, owner],
        "wall": wall.astype(np.float64),
        "image": image.astype(np.float64),
    }
    if is_uniform:
        del at_points[PRESSURE_NAME]
        _write_plant_cells(folder, seen, t)
    of_springs = {"wall_stretch": seen.stretch, "wall_tension_uN": seen.tension}
    write_series(folder, now[0], springs, t, at_points, of_springs)


def _write_plant_cells(folder: Path, seen: Particles, t: Array) -> None:
    """Write plant-cells.xdmf: plant cells as triangles from their middles, with their pressure."""
    points = []
    triangles = []
    cell_of = []
    first = 0  # number of the next point
    for k, rim in enumerate(seen.rims):
        offset = (seen.F @ seen.lattice) @ rim[:, 1:].T
        around = seen.position[:, rim[:, 0]] + offset.swapaxes(1, 2)
        points.append(np.concatenate([around, around.mean(axis=1, keepdims=True)], axis=1))
        corners = first + np.arange(len(rim))
        middle = np.full(len(rim), first + len(rim))
        triangles.append(np.stack([corners, np.roll(corners, -1), middle], axis=1))
        cell_of.append(np.full(len(rim), k))
        first += len(rim) + 1
    now = np.concatenate(points, axis=1)
    owner = np.concatenate(cell_of)
    in_cells = {
        PRESSURE_NAME: seen.pressure[:, owner],
        "cell_area_ratio": seen.area_ratio[:, owner],
    }
    motion = {DISPLACEMENT_NAME: now - now[0]}
    write_series(folder, now[0], np.concatenate(triangles), t, motion, in_cells, PLANT_CELLS)
