"""Particle fields of a full tissue over time as XDMF + HDF5, which ParaView opens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surrofe2.io.fields import Motion, motion_at, writing_series

Array = NDArray[np.float64]


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
    with writing_series(folder, position, "line", bonds) as writer:
        for k, t in enumerate(frames.t):
            writer.write_data(float(t), point_data=motion_at(frames, k) | {"wall": wall})
