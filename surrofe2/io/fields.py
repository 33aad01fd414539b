"""Fields over time as XDMF + HDF5, which ParaView opens."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Protocol

import numpy as np
from meshio.xdmf import TimeSeriesWriter
from numpy.typing import NDArray

from surrofe2.io.files import reported

Array = NDArray[np.float64]


class Motion(Protocol):
    """Fields of n points at m times: displacement and velocity (m, n, 2)."""

    @property
    def t(self) -> Array: ...  # noqa: D102 - the class says it
    @property
    def displacement(self) -> Array: ...  # noqa: D102
    @property
    def velocity(self) -> Array: ...  # noqa: D102


class Frames(Motion, Protocol):
    """The same of the nodes of a mesh; stress and F (m, e, 2, 2) of its elements."""

    @property
    def stress(self) -> Array: ...  # noqa: D102
    @property
    def F(self) -> Array: ...  # noqa: D102


def write_fields(folder: Path, nodes: Array, quads: NDArray[np.integer], frames: Frames) -> None:
    """Write fields.xdmf and fields.h5: nodes (n, 2) in µm, quads (e, 4), and the frames."""
    with _writing_series(folder, nodes, "quad", quads) as writer:
        for k, t in enumerate(frames.t):
            writer.write_data(
                float(t),
                point_data=_motion_at(frames, k),
                cell_data={
                    "cauchy_stress_uN_per_um": [_tensor_in_space(frames.stress[k])],
                    "deformation_gradient": [_tensor_in_space(frames.F[k], thickness=1.0)],
                },
            )


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
    with _writing_series(folder, position, "line", bonds) as writer:
        for k, t in enumerate(frames.t):
            writer.write_data(float(t), point_data=_motion_at(frames, k) | {"wall": wall})


@contextmanager
def _writing_series(
    folder: Path, points: Array, kind: str, cells: NDArray[np.integer]
) -> Iterator[TimeSeriesWriter]:
    """A writer of data at one time after another; fields.xdmf and fields.h5 appear at the end.

    Args:
        points: (n, 2) of the mesh, µm.
        kind: of its cells, as meshio calls it.
        cells: (e, …) the points of each.
    """
    with (
        reported(folder, "written"),
        tempfile.TemporaryDirectory(dir=folder, prefix=".fields") as place,
    ):
        # meshio puts the HDF5 part into the working folder, wherever the XDMF part goes.
        with chdir(place), TimeSeriesWriter("fields.xdmf") as writer:
            writer.write_points_cells(_in_space(points), [(kind, np.asarray(cells, np.int64))])
            yield writer
        for name in ("fields.h5", "fields.xdmf"):
            os.replace(Path(place) / name, folder / name)


def _motion_at(frames: Motion, k: int) -> dict[str, Array]:
    """Displacement and velocity of frame k by the names they have in the files."""
    return {
        "displacement_um": _in_space(frames.displacement[k]),
        "velocity_um_per_us": _in_space(frames.velocity[k]),
    }


def _in_space(vectors: Array) -> Array:
    """(n, 2) vectors as (n, 3)."""
    return np.pad(np.asarray(vectors, dtype=np.float64), ((0, 0), (0, 1)))


def _tensor_in_space(tensors: Array, thickness: float = 0.0) -> Array:
    """(e, 2, 2) tensors as (e, 3, 3) with `thickness` as the third diagonal entry."""
    out = np.zeros((len(tensors), 3, 3))
    out[:, :2, :2] = tensors
    out[:, 2, 2] = thickness
    return out
