"""A macro run at the end of a step: all that is needed to carry it on, and all it has found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class MacroState:
    """Plain arrays, numbers and dicts. The law's state is not among them: a resumed run starts
    the law cold, without warm start and without history.

    Attributes:
        t: µs. y: (4 n_free,) displacement and velocity of the free nodes.
        next_step: length proposed for the next step, µs.
        memory: what the integrator knows besides y, see `ImplicitStepper.memory`; empty if and
            only if it is the explicit one.
        work: (2,) internal and load work since t = 0, pJ.
        output_t: (r,) output times passed; watched: (r, 2) displacement there;
            energies: (3, r) kinetic energy, internal and load work there.
        dissipation_t, dissipation_rate: (s,) µs and pJ/µs, at ends of steps.
        frame_t: (k,); frame_displacement, frame_velocity: (k, n_nodes, 2);
            frame_stress, frame_F: (k, n_el, 2, 2).
        lowest, highest: (4, 2, 2) extremes of F, Ḟ, U and RᵀḞ.
        nodes, load, amplitude: what the run was of; a resumed run must have the same.
        counts, effort, wall_time: as in `MacroRun`.
    """

    t: float
    y: Array
    next_step: float
    memory: Array
    work: Array
    output_t: Array
    watched: Array
    energies: Array
    dissipation_t: Array
    dissipation_rate: Array
    frame_t: Array
    frame_displacement: Array
    frame_velocity: Array
    frame_stress: Array
    frame_F: Array
    lowest: Array
    highest: Array
    nodes: Array
    load: Array
    amplitude: Array
    counts: dict[str, int]
    effort: dict[str, int]
    wall_time: dict[str, float]

    def to_arrays(self) -> dict[str, NDArray]:
        """One array for each field; entries of dicts become ``"counts.steps"`` and so on."""
        arrays: dict[str, NDArray] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, dict):
                arrays |= {f"{item.name}.{key}": np.array(entry) for key, entry in value.items()}
            else:
                arrays[item.name] = np.array(value)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> MacroState:
        """The state whose `to_arrays` gave `arrays`.

        Raises:
            InputError: one of them is missing.
        """
        values: dict[str, Any] = {}
        for item in fields(cls):
            if str(item.type).startswith("dict"):
                values[item.name] = _dict_of(arrays, f"{item.name}.")
            elif item.name not in arrays:
                raise InputError(f"macro state: no {item.name!r}; the checkpoint is incomplete")
            elif item.type == "float":
                values[item.name] = float(arrays[item.name])
            else:
                values[item.name] = np.array(arrays[item.name], dtype=np.float64)
        return cls(**values)


def _dict_of(arrays: Mapping[str, NDArray], prefix: str) -> dict[str, float | int]:
    return {
        key.removeprefix(prefix): np.asarray(value).item()
        for key, value in arrays.items()
        if key.startswith(prefix)
    }
