"""The particles of one RVE over time, for ParaView."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surrofe2.io.fields import write_series
from surrofe2.rve.particles import Particles

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _WithImages:
    """An RVE with those images of its particles to which springs lead across its boundary.

    Attributes:
        owner: (p,) particle of each point. shift: (p, 2) lattice shift of each, 0 of the particles.
        springs: (b, 2) points.
    """

    owner: NDArray[np.int64]
    shift: NDArray[np.int64]
    springs: NDArray[np.int64]

    @classmethod
    def of(cls, seen: Particles) -> _WithImages:
        particles = seen.position.shape[1]
        across = seen.bond_shift.any(axis=1)
        needed = np.column_stack([seen.bonds[across, 1], seen.bond_shift[across]])
        images, place = np.unique(needed, axis=0, return_inverse=True)
        springs = seen.bonds.copy()
        springs[across, 1] = particles + place.ravel()
        own = np.column_stack([np.arange(particles), np.zeros((particles, 2), np.int64)])
        points = np.concatenate([own, images])
        return cls(points[:, 0], points[:, 1:], springs)

    def moved(self, vectors: Array, step: Array) -> Array:
        """(n, p, 2) vectors of the particles (n, particles, 2), of images by `step` (n, 2, 2) a
        shift more.
        """
        moved: Array = vectors[:, self.owner] + self.shift @ step.swapaxes(1, 2)
        return moved


def write_rve_fields(folder: Path, seen: Particles, t: Array) -> None:
    """Write fields.xdmf and fields.h5 of the RVE of `seen` at times t (n,), µs.

    Points are its particles as they are at the first time, with images where wall springs lead
    across its boundary; lines are the springs. `displacement_um` moves them.
    """
    points, particles = _WithImages.of(seen), seen.position.shape[1]
    walls = int(seen.is_wall.sum())

    now = points.moved(seen.position, seen.F @ seen.lattice)
    turgor, contact = np.zeros((2, len(t), particles))
    turgor[:, walls:], contact[:, :walls] = seen.pressure, seen.contact_pressure
    of_particles = np.stack([seen.is_wall[points.owner], (points.shift != 0).any(axis=1)])
    wall, image = np.broadcast_to(of_particles[:, None], (2, len(t), len(points.owner)))
    at_points = {
        "displacement_um": now - now[0],
        "velocity_um_per_us": points.moved(seen.velocity, seen.F_dot @ seen.lattice),
        "force_uN": seen.force[:, points.owner],
        "turgor_uN_per_um": turgor[:, points.owner],
        "contact_pressure_uN_per_um": contact[:, points.owner],
        "wall": wall.astype(np.float64),
        "image": image.astype(np.float64),
    }
    of_springs = {"wall_stretch": seen.stretch, "wall_tension_uN": seen.tension}
    write_series(folder, now[0], points.springs, t, at_points, of_springs)
