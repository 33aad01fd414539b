"""Particle fields of a full tissue over time as XDMF + HDF5, which ParaView opens."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path
from typing import Protocol

import meshio
import numpy as np
from numpy.typing import NDArray

from surrofe2.io.files import reported

Array = NDArray[np.float64]


class ParticleFrames(Protocol):
    """Fields at k times: displacement and velocity (k, particles, 2)."""

    @property
    def t(self) -> Array: ...  # noqa: D102 - the class says it
    @property
    def displacement(self) -> Array: ...  # noqa: D102
    @property
    def velocity(self) -> Array: ...  # noqa: D102


def write_particle_fields(
    folder: Path,
    position: Array,
    bonds: NDArray[np.integer],
    is_wall: NDArray[np.bool_],
    frames: ParticleFrames,
) -> None:
    """Write fields.xdmf and fields.h5.

    Points are particles at `position` (particles, 2) in µm, unloaded; wall springs `bonds` (b, 2)
    are lines between them. Fluid particles are points without lines, which ParaView shows as
    Point Gaussian or by Glyph; `wall` is 1 on wall particles, 0 on fluid.
    """
    lines = [("line", np.asarray(bonds, np.int64))]
    with (
        reported(folder, "written"),
        tempfile.TemporaryDirectory(dir=folder, prefix=".fields") as place,
    ):
        # meshio puts the HDF5 part into the working folder, wherever the XDMF part goes.
        with contextlib.chdir(place), meshio.xdmf.TimeSeriesWriter("fields.xdmf") as writer:
            writer.write_points_cells(_in_space(position), lines)
            for k, t in enumerate(frames.t):
                writer.write_data(
                    float(t),
                    point_data={
                        "displacement_um": _in_space(frames.displacement[k]),
                        "velocity_um_per_us": _in_space(frames.velocity[k]),
                        "wall": np.asarray(is_wall, np.float64),
                    },
                )
        for name in ("fields.h5", "fields.xdmf"):
            os.replace(Path(place) / name, folder / name)


def _in_space(vectors: Array) -> Array:
    """(n, 2) vectors as (n, 3)."""
    return np.pad(np.asarray(vectors, dtype=np.float64), ((0, 0), (0, 1)))
