"""Fields over time as XDMF + HDF5, which ParaView opens."""

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


class Frames(Protocol):
    """Fields at m times: displacement and velocity (m, n, 2), stress and F (m, e, 2, 2)."""

    @property
    def t(self) -> Array: ...  # noqa: D102 - the class says it
    @property
    def displacement(self) -> Array: ...  # noqa: D102
    @property
    def velocity(self) -> Array: ...  # noqa: D102
    @property
    def stress(self) -> Array: ...  # noqa: D102
    @property
    def F(self) -> Array: ...  # noqa: D102


def write_fields(folder: Path, nodes: Array, quads: NDArray[np.integer], frames: Frames) -> None:
    """Write fields.xdmf and fields.h5: nodes (n, 2) in µm, quads (e, 4), and the frames."""
    with (
        reported(folder, "written"),
        tempfile.TemporaryDirectory(dir=folder, prefix=".fields") as place,
    ):
        # meshio puts the HDF5 part into the working folder, wherever the XDMF part goes.
        with contextlib.chdir(place), meshio.xdmf.TimeSeriesWriter("fields.xdmf") as writer:
            writer.write_points_cells(_in_space(nodes), [("quad", np.asarray(quads, np.int64))])
            for k, t in enumerate(frames.t):
                writer.write_data(
                    float(t),
                    point_data={
                        "displacement_um": _in_space(frames.displacement[k]),
                        "velocity_um_per_us": _in_space(frames.velocity[k]),
                    },
                    cell_data={
                        "cauchy_stress_uN_per_um": [_tensor_in_space(frames.stress[k])],
                        "deformation_gradient": [_tensor_in_space(frames.F[k], thickness=1.0)],
                    },
                )
        for name in ("fields.h5", "fields.xdmf"):
            os.replace(Path(place) / name, folder / name)


def _in_space(vectors: Array) -> Array:
    """(n, 2) vectors as (n, 3)."""
    return np.pad(np.asarray(vectors, dtype=np.float64), ((0, 0), (0, 1)))


def _tensor_in_space(tensors: Array, thickness: float = 0.0) -> Array:
    """(e, 2, 2) tensors as (e, 3, 3) with `thickness` as the third diagonal entry."""
    out = np.zeros((len(tensors), 3, 3))
    out[:, :2, :2] = tensors
    out[:, 2, 2] = thickness
    return out
