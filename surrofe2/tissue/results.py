"""What a run of the full tissue hands back, and what carries it on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueState:
    """A run at an output time: all that is needed to carry it on, bit by bit, and its results.

    Attributes:
        rows: output times passed. relaxed, x, v: (particles, 2) the unloaded equilibrium,
            positions and velocities, µm and µm/µs. listed: (particles, 2) positions at which the
            neighbour lists in use were made.
        elastic: stored energy of the unloaded tissue, pJ.
        watched: (rows, 2) displacement; energies: (4, rows) kinetic, elastic, load, dissipated.
        frame_t: (k,); frame_displacement, frame_velocity: (k, particles, 2).
        identity: numbers that a run to be resumed must share.
        steps, force_evaluations, list_builds: counts. relaxation_time, run_time: s.
    """

    rows: int
    relaxed: Array
    x: Array
    v: Array
    listed: Array
    elastic: float
    watched: Array
    energies: Array
    frame_t: Array
    frame_displacement: Array
    frame_velocity: Array
    identity: Array
    steps: int
    force_evaluations: int
    list_builds: int
    relaxation_time: float
    run_time: float

    def to_arrays(self) -> dict[str, NDArray]:
        """One array for each field."""
        return {item.name: np.array(getattr(self, item.name)) for item in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> TissueState:
        """The state whose `to_arrays` gave `arrays`."""
        values: dict[str, Any] = {}
        for item in fields(cls):
            if item.name not in arrays:
                raise InputError(f"tissue state: no {item.name!r}; the checkpoint is incomplete")
            value = np.asarray(arrays[item.name])
            values[item.name] = value.item() if item.type in ("int", "float") else value
        return cls(**values)


@dataclass(frozen=True, slots=True)
class ParticleFrames:
    """Particle fields at k times: t (k,) µs; displacement, velocity (k, particles, 2)."""

    t: Array
    displacement: Array
    velocity: Array


@dataclass(frozen=True, slots=True)
class TissueRun:
    """A run, or with `finished` False the part of it that was computed.

    Attributes:
        curve: displacement of the watched particle from the unloaded equilibrium.
        energies: by name, (m,) pJ at the output times: `kinetic`; `elastic`, since the unloaded
            equilibrium; `load` work; `dissipated` by dashpots and viscosity; `balance`, load −
            kinetic − elastic − dissipated, zero but for the error of the time integration.
        position: (particles, 2) the unloaded equilibrium, µm; walls first.
        bonds: (b, 2) bonded wall particles. is_wall: (particles,).
        frames: particle fields at a few times.
        wall_time: s, `total`, `relaxation` and `run`.
        counts: `steps`, `force_evaluations`, `list_builds`, `particles`, `particle_steps`.
    """

    curve: DisplacementCurve
    energies: dict[str, Array]
    position: Array
    bonds: NDArray[np.int64]
    is_wall: NDArray[np.bool_]
    frames: ParticleFrames
    wall_time: dict[str, float]
    counts: dict[str, int]
    threads: int
    finished: bool
