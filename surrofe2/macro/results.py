"""What a macro run hands back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.macro.internal_force import element_mean_stress
from surrofe2.macro.mesh import Bar
from surrofe2.macro.quasi_static import Rest
from surrofe2.macro.selective_quadrature import CENTRE, N_POINTS
from surrofe2.macro.state import MacroState

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Frames:
    """Whole fields at k times, each the end of the first step that passed an even fraction of the
    duration: there the stress is the one the run went on with, and nothing is interpolated.

    Attributes:
        t: (k,) µs, increasing, from 0 to the end.
        displacement, velocity: (k, n_nodes, 2) µm and µm/µs.
        stress: (k, n_el, 2, 2) element mean of the Cauchy stress, µN/µm.
        F: (k, n_el, 2, 2) deformation gradient at the element centres.
    """

    t: Array
    displacement: Array
    velocity: Array
    stress: Array
    F: Array


@dataclass(frozen=True, slots=True)
class MetRange:
    """Lowest and highest entry that any point met at the end of any step, each (2, 2).

    With F = R U: a sampling range over (U, RᵀḞ) that holds these holds the run.
    """

    F: tuple[Array, Array]
    F_dot: tuple[Array, Array]
    U: tuple[Array, Array]
    RT_F_dot: tuple[Array, Array]

    @property
    def stretch(self) -> tuple[float, float]:
        """Lowest and highest of U₁₁ and U₂₂."""
        low, high = self.U
        return float(low.diagonal().min()), float(high.diagonal().max())

    @property
    def shear(self) -> float:
        """Largest |U₁₂|."""
        low, high = self.U
        return float(max(-low[0, 1], high[0, 1]))

    @property
    def rate(self) -> float:
        """Largest entry of |RᵀḞ|, 1/µs."""
        low, high = self.RT_F_dot
        return float(max(-low.min(), high.max()))


@dataclass(frozen=True, slots=True)
class MacroRun:
    """A run, or with `finished` False the part of it that was computed.

    Attributes:
        curve: displacement of the watched point at the output times.
        energies: by name, (m,) arrays in pJ at the output times: `kinetic` energy; `internal`
            and `load`, the work of the internal and of the load forces since t = 0, integrated
            along with the equations of motion by the same method; `balance`, load − kinetic −
            internal, zero but for the error of the time integration; `dissipated`, the work of
            the stress in excess of σ(F, 0), from samples at the ends of steps joined by a
            monotone cubic (second order or better), NaN where not recorded.
        nodes: (n_nodes, 2) reference positions, µm; quads: (n_el, 4) their nodes.
        frames: whole fields at a few times.
        met: extremes of deformation and rate.
        wall_time: seconds, `total`, `law` (inside the stress law) and `macro` (the rest).
        counts: `steps` accepted, `rejected_steps` as too inaccurate, `failed_trials` without
            stress or turned back by the law, `right_hand_sides`, `stress_calls` and
            `stress_points` of those, `dissipation_points` and `dissipation_failures` of the
            questions for σ(F, 0), which come on top.
        effort: sums of what the law's answers say they cost, those for dissipation included.
        threads: that numba could use.
        finished: whether the end of the load case was reached.
    """

    curve: DisplacementCurve
    energies: dict[str, Array]
    nodes: Array
    quads: NDArray[np.int64]
    frames: Frames
    met: MetRange
    wall_time: dict[str, float]
    counts: dict[str, int]
    effort: dict[str, int]
    threads: int
    finished: bool


def rest_frames(path: Sequence[Rest]) -> Frames:
    """Whole fields of states of rest, the factor of the load in the place of time."""
    bar = path[0].bar
    displacement = np.stack([bar.on_all_nodes(rest.u) for rest in path])
    stress = [element_mean_stress(bar, np.linalg.det(rest.F), rest.stress) for rest in path]
    return Frames(
        t=np.array([rest.factor for rest in path]),
        displacement=displacement,
        velocity=np.zeros_like(displacement),
        stress=np.stack(stress),
        F=np.stack([rest.F[CENTRE::N_POINTS] for rest in path]),
    )


def make_run(bar: Bar, state: MacroState, finished: bool) -> MacroRun:
    """The results that `state` holds."""
    kinetic, internal, load = state.energies
    low, high = state.lowest, state.highest
    return MacroRun(
        curve=DisplacementCurve(state.output_t, state.watched),
        energies={
            "kinetic": kinetic,
            "internal": internal,
            "load": load,
            "dissipated": _dissipated(state),
            "balance": load - kinetic - internal,
        },
        nodes=bar.nodes,
        quads=bar.quads,
        frames=Frames(
            t=state.frame_t,
            displacement=state.frame_displacement,
            velocity=state.frame_velocity,
            stress=state.frame_stress,
            F=state.frame_F,
        ),
        met=MetRange(*((low[k], high[k]) for k in range(4))),
        wall_time=state.wall_time,
        counts=state.counts,
        effort=state.effort,
        threads=numba.get_num_threads(),
        finished=finished,
    )


def _dissipated(state: MacroState) -> Array:
    """(r,) ∫ rate dt at the output times.

    A monotone cubic stays between its samples, so the work of a rate that is never negative
    never falls.
    """
    if state.dissipation_t.size < 2:
        return np.where(state.output_t == 0.0, 0.0, np.nan)
    rate = PchipInterpolator(state.dissipation_t, state.dissipation_rate, extrapolate=False)
    dissipated: Array = rate.antiderivative()(state.output_t)
    return dissipated
