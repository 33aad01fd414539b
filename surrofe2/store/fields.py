"""Fields over time as XDMF + HDF5, which ParaView opens: of elements, particles, or law points."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import FileError
from surrofe2.store.hdf5 import Kind, reading, store_array, writing
from surrofe2.store.store import write_text

if TYPE_CHECKING:
    from surrofe2.macro.history import Frames
    from surrofe2.rve.particles import Particles
    from surrofe2.tissue.simulation import ParticleFrames

Series = Mapping[str, NDArray[Any]]
"""Values over time by name: numbers (m, n), vectors (m, n, 2) or tensors (m, n, 2, 2)."""
F_NAME, F_DOT_NAME = "deformation_gradient", "deformation_rate_1_per_us"
STRESS_NAME, SOURCE_NAME = "cauchy_stress_uN_per_um", "stress_source"
RISK_NAME = "risk"
DISPLACEMENT_NAME, VELOCITY_NAME = "displacement_um", "velocity_um_per_us"
CELL = "plant_cell"
_MOTION = (DISPLACEMENT_NAME, VELOCITY_NAME)
_TENSORS = (STRESS_NAME, F_NAME, F_DOT_NAME)
FIELDS_FILE = Kind("fields", 1)
FIELDS, POINTS, PLANT_CELLS = "fields", "points", "plant-cells"
"""Names of the two files of elements or particles, of points of the law, and of plant cells."""
TURGOR_NAME = "turgor_uN_per_um"
_KINDS = {1: "Polyvertex", 2: "Polyline", 3: "Triangle", 4: "Quadrilateral", 6: "Triangle_6"}
"""What XDMF calls cells of so many points; those of six have the middles of their sides."""


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
    at_nodes = {DISPLACEMENT_NAME: frames.displacement, VELOCITY_NAME: frames.velocity}
    in_elements = {
        STRESS_NAME: frames.stress,
        F_NAME: frames.F,
        F_DOT_NAME: frames.F_dot,
        **invariants(frames.stress),
        SOURCE_NAME: frames.source,
        RISK_NAME: frames.risk,
        "dissipated_energy_pJ_per_um2": frames.dissipated,
    }
    if cell is not None:
        in_elements[CELL] = np.broadcast_to(cell, (len(frames.t), len(cell)))
    write_series(folder, nodes, elements, frames.t, at_nodes, in_elements)


def invariants(stress: Array) -> dict[str, Array]:
    """Of (…, 2, 2) stresses in the plane, µN/µm, free across it: pressure −(σ₁ + σ₂)/2,
    √(σ₁² − σ₁σ₂ + σ₂²) of von Mises, largest shear (σ₁ − σ₂)/2.
    """
    xx, yy, off = stress[..., 0, 0], stress[..., 1, 1], stress[..., 0, 1] + stress[..., 1, 0]
    mean, shear = 0.5 * (xx + yy), 0.5 * np.hypot(xx - yy, off)
    return {
        "pressure_in_plane_uN_per_um": -mean,
        "von_mises_in_plane_uN_per_um": np.sqrt(mean**2 + 3.0 * shear**2),
        "largest_shear_in_plane_uN_per_um": shear,
    }


def write_particle_fields(
    folder: Path,
    position: Array,
    bonds: NDArray[np.integer],
    is_wall: Flags,
    frames: ParticleFrames,
) -> None:
    """Write fields.xdmf and fields.h5.

    Points are particles at `position` (particles, 2) in µm, unloaded; wall springs `bonds` (b, 2)
    are lines between them; `wall` is 1 on wall particles, 0 on fluid.
    """
    wall = np.broadcast_to(np.asarray(is_wall, np.float64), (len(frames.t), len(is_wall)))
    motion = {DISPLACEMENT_NAME: frames.displacement, VELOCITY_NAME: frames.velocity}
    write_series(folder, position, bonds, frames.t, {**motion, "wall": wall}, {})


def write_point_fields(
    folder: Path, position: Array, t: Array, values: Series, per_element: int
) -> None:
    """Write points.xdmf and points.h5: what the law was asked and answered at its points (n, 2),
    µm, those of an element one after the other, at times t (m,) µs."""
    each = np.arange(len(position))
    element = np.broadcast_to((each // per_element).astype(np.float64), (len(t), len(each)))
    values = {**values, **invariants(values[STRESS_NAME]), "element": element}
    write_series(folder, position, each[:, None], t, values, {}, POINTS)


def write_series(
    folder: Path,
    points: Array,
    cells: NDArray[np.integer],
    t: Array,
    at_points: Series,
    in_cells: Series,
    name: str = FIELDS,
) -> None:
    """Write values of points (n, 2), µm, and cells (e, k) at times t (m,); an empty series (m, 0)
    is left out. The mesh is stored once; every time is a grid of its own that refers to it."""
    with writing(folder / f"{name}.h5", FIELDS_FILE, {}) as file:

        def stored(entry: str, values: NDArray[Any]) -> str:
            store_array(file, entry, values)
            number = "Int" if values.dtype.kind == "i" else "Float"
            shape = " ".join(map(str, values.shape))
            head = f'<DataItem DataType="{number}" Precision="8" Dimensions="{shape}" Format="HDF">'
            return f"{head}{name}.h5:/{entry}</DataItem>"

        def attribute(what: str, centre: str, k: int, of_plane: NDArray[Any]) -> str:
            values = _in_space(of_plane, thickness=float(what == F_NAME))
            kind = {1: "Scalar", 2: "Vector", 3: "Tensor"}[values.ndim]
            head = f'<Attribute Name="{what}" AttributeType="{kind}" Center="{centre}">'
            return f"{head}{stored(f'{what}.{k}', values)}</Attribute>\n"

        mesh = (
            f'<Topology TopologyType="{_KINDS[cells.shape[1]]}" NumberOfElements="{len(cells)}" '
            f'NodesPerElement="{cells.shape[1]}">'
            f"{stored('cells', np.asarray(cells, np.int64))}</Topology>\n"
            f'<Geometry GeometryType="XYZ">{stored("points", _in_space(points))}</Geometry>\n'
        )
        grids = []
        for k, time in enumerate(t):
            attributes = [
                attribute(what, centre, k, series[k])
                for centre, data in (("Node", at_points), ("Cell", in_cells))
                for what, series in data.items()
                if series.shape[1]
            ]
            grids.append(
                f'<Grid Name="{k}" GridType="Uniform">\n<Time Value="{float(time)!r}"/>\n'
                f"{mesh}{''.join(attributes)}</Grid>\n"
            )
        file["t"] = np.asarray(t, np.float64)
    text = (
        '<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>\n'
        f'<Grid Name="{name}" GridType="Collection" CollectionType="Temporal">\n'
        f"{''.join(grids)}</Grid>\n</Domain></Xdmf>\n"
    )
    write_text(folder / f"{name}.xdmf", text)


def _in_space(values: NDArray[Any], thickness: float = 0.0) -> NDArray[Any]:
    """(n, 2) vectors as (n, 3), (n, 2, 2) tensors as (n, 3, 3) with `thickness` as the third
    diagonal entry, numbers as they are.
    """
    out = np.pad(values, [(0, 0)] + [(0, 1)] * (values.ndim - 1))
    if values.ndim == 3:
        out[:, 2, 2] = thickness
    return out


def add_to_elements(folder: Path, added: Series) -> None:
    """Add values (m, e) of the elements, by name, to the fields of a folder, or renew them."""
    stored = read_fields(folder, (), None)
    at_points = {name: of for name, of in stored.values.items() if name in _MOTION}
    in_cells = {name: of for name, of in stored.values.items() if name not in _MOTION}
    write_series(folder, stored.points, stored.cells, stored.t, at_points, in_cells | {**added})


@dataclass(frozen=True, slots=True)
class StoredFields:
    """Fields over time, read back.

    Attributes:
        points: (n, 2) reference positions, µm. cells: (e, k) points of each element or spring.
        t: (m,) µs; of a rest the factor of the load.
        values: by name, numbers (m, e) and tensors (m, e, 2, 2) of cells, or of points of the law;
            displacement and velocity (m, n, 2) of points.
    """

    points: Array
    cells: Index
    t: Array
    values: dict[str, Array]

    @property
    def displacement(self) -> Array:
        """(m, n, 2) µm."""
        return self.values[DISPLACEMENT_NAME]


def read_fields(
    folder: Path, needed: Iterable[str], others: Iterable[str] | None = (), name: str = FIELDS
) -> StoredFields:
    """The mesh of fields.h5, or of points.h5, the values of the `needed` names, and of the `others`
    where they are there (None: of all); FileError where the file is missing or damaged, or values
    are needed."""
    path = folder / f"{name}.h5"
    with reading(path, FIELDS_FILE) as stored:
        there = dict.fromkeys(key.rpartition(".")[0] for key in stored.file if "." in key)
        for what in needed:
            if what not in there:
                raise FileError(f"{path}: no {what} in it; run it again with --fresh")
        t, points = stored.array("t", (None,)), stored.array("points", (None, 3))
        cells = stored.array("cells", (None, None), np.int64)
        if not (len(t) and 0 <= cells.min(initial=0) <= cells.max(initial=0) < len(points)):
            raise ValueError("t or cells: empty, or of points that are not there")
        values = {}
        for what in there if others is None else (*needed, *others):
            if what in there:
                axes = 2 if what in _TENSORS else int(what in _MOTION)
                shape = (len(points if what in _MOTION else cells), *(3,) * axes)
                whole = [stored.array(f"{what}.{k}", shape) for k in range(len(t))]
                in_plane: Any = (..., *(slice(2),) * axes)
                values[what] = np.stack(whole)[in_plane]
        return StoredFields(points[:, :2], cells, t, values)


def write_rve_fields(folder: Path, seen: Particles, t: Array) -> None:
    """Write fields.xdmf and fields.h5 of the RVE of `seen` at times t (n,), µs.

    Points are its particles as they are at the first time, with images where wall springs lead
    across its boundary; lines are the springs. A uniform fluid is in plant-cells.xdmf and .h5.
    """
    is_uniform = bool(seen.is_wall.all())
    particles, walls = seen.position.shape[1], int(seen.is_wall.sum())
    across = seen.bond_shift.any(axis=1)
    needed = np.column_stack([seen.bonds[across, 1], seen.bond_shift[across]])
    images, place = np.unique(needed, axis=0, return_inverse=True)
    springs = seen.bonds.copy()
    springs[across, 1] = particles + place.ravel()
    owner = np.append(np.arange(particles), images[:, 0])  # the particle of each point
    shift = np.append(np.zeros((particles, 2), np.int64), images[:, 1:], axis=0)  # in periods

    def moved(vectors: Array, step: Array) -> Array:
        """(n, p, 2) vectors of particles (n, particles, 2), of images by `step` a period more."""
        of_points: Array = vectors[:, owner] + shift @ step.swapaxes(1, 2)
        return of_points

    now = moved(seen.position, seen.F @ seen.lattice)
    turgor, contact = np.zeros((2, len(t), particles))
    contact[:, :walls] = seen.contact_pressure
    if not is_uniform:
        turgor[:, walls:] = seen.pressure
    of_particles = np.stack([seen.is_wall[owner], (shift != 0).any(axis=1)])
    wall, image = np.broadcast_to(of_particles[:, None], (2, len(t), len(owner)))
    at_points = {
        "displacement_um": now - now[0],
        "velocity_um_per_us": moved(seen.velocity, seen.F_dot @ seen.lattice),
        "force_uN": seen.force[:, owner],
        TURGOR_NAME: turgor[:, owner],
        "contact_pressure_uN_per_um": contact[:, owner],
        "wall": wall.astype(np.float64),
        "image": image.astype(np.float64),
    }
    if is_uniform:
        del at_points[TURGOR_NAME]
        _write_plant_cells(folder, seen, t)
    of_springs = {"wall_stretch": seen.stretch, "wall_tension_uN": seen.tension}
    write_series(folder, now[0], springs, t, at_points, of_springs)


def _write_plant_cells(folder: Path, seen: Particles, t: Array) -> None:
    """Write plant-cells.xdmf and plant-cells.h5: plant cells as triangles from the middle of each,
    with the pressure of its fluid."""
    points, triangles, cell_of, first = [], [], [], 0
    for k, rim in enumerate(seen.rims):
        offset = (seen.F @ seen.lattice) @ rim[:, 1:].T
        around = seen.position[:, rim[:, 0]] + offset.swapaxes(1, 2)
        points.append(np.concatenate([around, around.mean(axis=1, keepdims=True)], axis=1))
        here = first + np.arange(len(rim))
        middle = np.full(len(rim), first + len(rim))
        triangles.append(np.stack([here, np.roll(here, -1), middle], axis=1))
        cell_of.append(np.full(len(rim), k))
        first += len(rim) + 1
    now, of = np.concatenate(points, axis=1), np.concatenate(cell_of)
    in_cells = {TURGOR_NAME: seen.pressure[:, of], "cell_area_ratio": seen.area_ratio[:, of]}
    motion = {DISPLACEMENT_NAME: now - now[0]}
    write_series(folder, now[0], np.concatenate(triangles), t, motion, in_cells, PLANT_CELLS)
