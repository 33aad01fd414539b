"""Fields over time as XDMF + HDF5, which ParaView opens."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import h5py
import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import FileError
from surrofe2.io.files import reported, write_text
from surrofe2.io.hdf5 import reading_hdf5, stored_array, writing_hdf5

Array = NDArray[np.float64]
Data = dict[str, Array]
F_NAME, F_DOT_NAME = "deformation_gradient", "deformation_rate_1_per_us"
STRESS_NAME, SOURCE_NAME = "cauchy_stress_uN_per_um", "stress_source"
BOUND_NAME = "stress_bound_uN_per_um"
DISPLACEMENT_NAME, VELOCITY_NAME = "displacement_um", "velocity_um_per_us"
CELL = "plant_cell"
_RANKS = {1: "Scalar", 2: "Vector", 3: "Tensor"}
"""What XDMF calls data of so many axes."""


class Motion(Protocol):
    """Fields of n points at m times: displacement and velocity (m, n, 2)."""

    @property
    def t(self) -> Array: ...
    @property
    def displacement(self) -> Array: ...
    @property
    def velocity(self) -> Array: ...


class Frames(Motion, Protocol):
    """The same of the nodes of a mesh; stress, F and Ḟ (m, e, 2, 2), source and bound (m, e) of
    its elements, these two and the energy `dissipated` by area (m, 0) where not known.
    """

    @property
    def stress(self) -> Array: ...
    @property
    def F(self) -> Array: ...
    @property
    def F_dot(self) -> Array: ...
    @property
    def source(self) -> Array: ...
    @property
    def bound(self) -> Array: ...
    @property
    def dissipated(self) -> Array: ...


def write_fields(
    folder: Path,
    nodes: Array,
    elements: NDArray[np.integer],
    frames: Frames,
    cell: Array | None = None,
) -> None:
    """Write fields.xdmf and fields.h5: a mesh in µm and what its nodes and elements have.

    Args:
        nodes: (n, 2) µm.
        elements: (e, 4) quadrilaterals or (e, 6) triangles with the middles of their sides.
        cell: (e,) number of each element's plant cell, where there are several.
    """
    kind = {4: "Quadrilateral", 6: "Triangle_6"}[elements.shape[1]]
    with writing_series(folder, nodes, kind, elements) as write:
        for k, t in enumerate(frames.t):
            stress = frames.stress[k]
            in_elements = {
                STRESS_NAME: tensor_in_space(stress),
                F_NAME: tensor_in_space(frames.F[k], thickness=1.0),
                F_DOT_NAME: tensor_in_space(frames.F_dot[k]),
                **invariants(stress),
            }
            if frames.source.size:
                in_elements |= {SOURCE_NAME: frames.source[k], BOUND_NAME: frames.bound[k]}
            if frames.dissipated.size:
                in_elements["dissipated_energy_pJ_per_um2"] = frames.dissipated[k]
            if cell is not None:
                in_elements[CELL] = cell
            write(float(t), _motion_at(frames, k), in_elements)


@dataclass(frozen=True, slots=True)
class ElementMotion:
    """A mesh and the F and Ḟ (m, e, 2, 2) of its elements at times t (m,), µs, read back.

    Attributes:
        cell: (e,) number of each element's plant cell; None where there is one.
    """

    nodes: Array
    elements: NDArray[np.int64]
    t: Array
    F: Array
    F_dot: Array
    cell: NDArray[np.int64] | None


def read_element_motion(folder: Path) -> ElementMotion:
    """What `write_fields` wrote of the motion of elements.

    Raises:
        FileError: fields.h5 is missing, damaged, or without Ḟ.
    """
    path = folder / "fields.h5"
    with reading_hdf5(path) as file:
        if f"{F_DOT_NAME}.0" not in file:
            raise FileError(f"{path}: no {F_DOT_NAME} of elements in it; run anew with --fresh")
        t, nodes = stored_array(file, "t", (None,)), stored_array(file, "points", (None, 3))
        elements = stored_array(file, "cells", (None, None), np.int64)
        if not (len(t) and 0 <= elements.min(initial=0) <= elements.max(initial=0) < len(nodes)):
            raise ValueError("t or cells: empty, or of points that are not there")
        tensors = (len(elements), 3, 3)
        F, F_dot = (
            np.stack([stored_array(file, f"{name}.{k}", tensors) for k in range(len(t))])
            for name in (F_NAME, F_DOT_NAME)
        )
        cell = None
        if f"{CELL}.0" in file:
            kind = file[f"{CELL}.0"].dtype
            if kind.kind not in "if":
                raise ValueError(f"{CELL}.0: {kind}; it must be numbers")
            cell = stored_array(file, f"{CELL}.0", (len(elements),), kind).astype(np.int64)
        return ElementMotion(nodes[:, :2], elements, t, F[..., :2, :2], F_dot[..., :2, :2], cell)


def invariants(stress: Array) -> dict[str, Array]:
    """Of (e, 2, 2) stresses in the plane, µN/µm, free across it: pressure −(σ₁ + σ₂)/2,
    √(σ₁² − σ₁σ₂ + σ₂²) of von Mises, largest shear (σ₁ − σ₂)/2.
    """
    mean = 0.5 * (stress[:, 0, 0] + stress[:, 1, 1])
    off = 0.5 * (stress[:, 0, 1] + stress[:, 1, 0])
    shear = np.hypot(0.5 * (stress[:, 0, 0] - stress[:, 1, 1]), off)
    return {
        "pressure_in_plane_uN_per_um": -mean,
        "von_mises_in_plane_uN_per_um": np.sqrt(mean**2 + 3.0 * shear**2),
        "largest_shear_in_plane_uN_per_um": shear,
    }


def write_particle_fields(
    folder: Path,
    position: Array,
    bonds: NDArray[np.integer],
    is_wall: NDArray[np.bool_],
    frames: Motion,
) -> None:
    """Write fields.xdmf and fields.h5.

    Points are particles at `position` (particles, 2) in µm, unloaded; wall springs `bonds` (b, 2)
    are lines between them. Fluid particles are points without lines, which ParaView shows as
    Point Gaussian or by Glyph; `wall` is 1 on wall particles, 0 on fluid.
    """
    wall = np.asarray(is_wall, np.float64)
    with writing_series(folder, position, "Polyline", bonds) as write:
        for k, t in enumerate(frames.t):
            write(float(t), _motion_at(frames, k) | {"wall": wall}, {})


@contextmanager
def writing_series(
    folder: Path, points: Array, kind: str, cells: NDArray[np.integer], name: str = "fields"
) -> Iterator[Callable[[float, Data, Data], None]]:
    """A function that writes t and the data of points and cells; the files appear at the end.

    The mesh is stored once; every time is a grid of its own that refers to it, so that a reader
    sees one mesh which changes, and no second one beside it.

    Args:
        points: (n, 2) of the mesh, µm.
        kind: of its cells, as XDMF calls it.
        cells: (e, k) the points of each.
        name: of the two files.
    """
    grids: list[str] = []
    times: list[float] = []
    with writing_hdf5(folder / f"{name}.h5") as file:

        def stored(entry: str, values: NDArray[Any]) -> str:
            # As file[entry] = values, in 0.05 ms instead of 0.13: a run stores a thousand of them.
            kind = h5py.h5t.py_create(values.dtype, logical=True)
            space = h5py.h5s.create_simple(values.shape)
            held = h5py.h5d.create(file.id, entry.encode(), kind, space)
            held.write(h5py.h5s.ALL, h5py.h5s.ALL, np.ascontiguousarray(values))
            return _item(entry, values, f"{name}.h5")

        mesh = (
            f'<Topology TopologyType="{kind}" NumberOfElements="{len(cells)}" '
            f'NodesPerElement="{cells.shape[1]}">'
            f"{stored('cells', np.asarray(cells, np.int64))}</Topology>\n"
            f'<Geometry GeometryType="XYZ">{stored("points", in_space(points))}</Geometry>\n'
        )

        def write(t: float, at_points: Data, in_cells: Data) -> None:
            attributes = [
                _attribute(what, centre, stored(f"{what}.{len(grids)}", values), values.ndim)
                for centre, data in (("Node", at_points), ("Cell", in_cells))
                for what, values in data.items()
            ]
            times.append(t)
            grids.append(
                f'<Grid Name="{len(grids)}" GridType="Uniform">\n<Time Value="{t!r}"/>\n'
                f"{mesh}{''.join(attributes)}</Grid>\n"
            )

        yield write
        file["t"] = np.array(times)
    text = (
        '<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>\n'
        f'<Grid Name="{name}" GridType="Collection" CollectionType="Temporal">\n'
        f"{''.join(grids)}</Grid>\n</Domain></Xdmf>\n"
    )
    write_text(folder / f"{name}.xdmf", text)


def _item(name: str, values: NDArray[Any], file: str = "fields.h5") -> str:
    """The words of XDMF for a data set of a file."""
    number = "Int" if values.dtype.kind == "i" else "Float"
    shape = " ".join(map(str, values.shape))
    return (
        f'<DataItem DataType="{number}" Precision="8" Dimensions="{shape}" '
        f'Format="HDF">{file}:/{name}</DataItem>'
    )


def _attribute(name: str, centre: str, item: str, rank: int) -> str:
    return (
        f'<Attribute Name="{name}" AttributeType="{_RANKS[rank]}" Center="{centre}">'
        f"{item}</Attribute>\n"
    )


def add_to_elements(folder: Path, added: Mapping[str, Array]) -> None:
    """Add values (m, e) of the elements, by name, to the fields of a folder, or renew them.

    Raises:
        FileError: there are none, or they are damaged.
    """
    of_frames = {f"{name}.{k}": at for name, of in added.items() for k, at in enumerate(of)}
    path = folder / "fields.h5"
    with reading_hdf5(path) as there, writing_hdf5(path) as file:
        for name in there:
            if name not in of_frames:
                there.copy(name, file)
        for name, values in of_frames.items():
            file[name] = values
    path = folder / "fields.xdmf"
    with reported(path, "read"):
        *grids, end = path.read_text(encoding="utf-8").split("</Grid>\n")
    for k in range(len(grids) - 1):
        for name, values in added.items():
            words = _attribute(name, "Cell", _item(f"{name}.{k}", values[k]), 1)
            grids[k] += "" if words in grids[k] else words
    write_text(path, "</Grid>\n".join([*grids, end]))


def _motion_at(frames: Motion, k: int) -> dict[str, Array]:
    """Displacement and velocity of frame k by the names they have in the files."""
    return {
        DISPLACEMENT_NAME: in_space(frames.displacement[k]),
        VELOCITY_NAME: in_space(frames.velocity[k]),
    }


def in_space(vectors: Array) -> Array:
    """(n, 2) vectors as (n, 3)."""
    return np.pad(np.asarray(vectors, dtype=np.float64), ((0, 0), (0, 1)))


def tensor_in_space(tensors: Array, thickness: float = 0.0) -> Array:
    """(e, 2, 2) tensors as (e, 3, 3) with `thickness` as the third diagonal entry."""
    out = np.zeros((len(tensors), 3, 3))
    out[:, :2, :2] = tensors
    out[:, 2, 2] = thickness
    return out
