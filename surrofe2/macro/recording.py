"""Collecting the results of a run, step by step, so that an interrupt cannot tear them."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from surrofe2.load_case import LoadCase
from surrofe2.macro.internal_force import element_mean_stress
from surrofe2.macro.kernels import widen_extremes
from surrofe2.macro.mesh import Bar
from surrofe2.macro.right_hand_side import Evaluation, RightHandSide
from surrofe2.macro.selective_quadrature import CENTRE, N_POINTS
from surrofe2.macro.settings import MacroSettings
from surrofe2.macro.state import MacroState
from surrofe2.macro.time_integration import AcceptedStep

Array = NDArray[np.float64]

COUNTS = (
    "steps",
    "rejected_steps",
    "failed_trials",
    "repeated_steps",
    "right_hand_sides",
    "factorisations",
    "stress_calls",
    "stress_points",
    "dissipation_points",
    "dissipation_failures",
)


@dataclass(frozen=True, slots=True)
class _Mark:
    """How far the recording has come; replaced as a whole at the end of each step."""

    t: float
    y: Array
    next_step: float
    memory: Array
    work: Array
    rows: int
    samples: int
    frames: int
    lowest: Array
    highest: Array


class Recorder:
    """Results in arrays as long as the whole run needs; what lies beyond the mark is not valid."""

    def __init__(
        self,
        right_hand_side: RightHandSide,
        load_case: LoadCase,
        settings: MacroSettings,
        resume: MacroState | None = None,
    ) -> None:
        self._right_hand_side = right_hand_side
        self._bar = bar = right_hand_side.bar
        self._end = load_case.duration
        self._started = perf_counter() - (resume.wall_time["total"] if resume else 0.0)
        self._amplitude = np.array(load_case.amplitude, dtype=np.float64).reshape(-1, 2)
        self._record_dissipation = settings.record_dissipation
        self._t = load_case.output_times()
        self._frame_fractions = np.linspace(0.0, load_case.duration, settings.frames)
        n_nodes, n_el = len(bar.nodes), len(bar.quads)
        n_frames = settings.frames + (resume.frame_t.size if resume else 0)
        self._watched = np.empty((self._t.size, 2))
        self._energies = np.empty((3, self._t.size))
        self._sample_t = np.empty(self._t.size)
        self._sample_rate = np.empty(self._t.size)
        self._frame_t = np.empty(n_frames)
        self._frame_nodal = np.empty((2, n_frames, n_nodes, 2))
        self._frame_element = np.empty((2, n_frames, n_el, 2, 2))
        self._mark: _Mark

    def begin(self, start: Evaluation, next_step: float, memory: Array) -> None:
        """Record the state at rest at t = 0."""
        self._watched[0] = self._bar.at_watched_point(start.u)
        self._energies[:, 0] = _kinetic(self._bar, start.v), 0.0, 0.0
        # At rest nothing dissipates.
        self._sample_t[0] = self._sample_rate[0] = 0.0
        self._keep_frame(0, start)
        lowest, highest = np.full((4, 2, 2), np.inf), np.full((4, 2, 2), -np.inf)
        widen_extremes(lowest, highest, start.F, start.F_dot)
        y = np.concatenate([start.u.ravel(), start.v.ravel()])
        samples = 1 if self._record_dissipation else 0
        self._mark = _Mark(0.0, y, next_step, memory, np.zeros(2), 1, samples, 1, lowest, highest)

    def record(self, step: AcceptedStep) -> None:
        """Record an accepted step."""
        mark = self._mark
        rows = self._rows_at(step.t)
        for row in range(mark.rows, rows):
            self._keep_row(row, step, mark.work)
        samples = mark.samples
        if self._record_dissipation and self._is_due(mark, rows):
            rate = self._right_hand_side.dissipation_rate()
            if not np.isnan(rate):
                self._sample_t[samples], self._sample_rate[samples] = step.t, rate
                samples += 1
        frames = mark.frames
        if self._frames_due(step.t) > self._frames_due(step.t_old):
            self._keep_frame(frames, step.evaluation)
            frames += 1
        lowest, highest = mark.lowest.copy(), mark.highest.copy()
        widen_extremes(lowest, highest, step.evaluation.F, step.evaluation.F_dot)
        work = mark.work + step.work(step.t)
        self._mark = _Mark(
            t=step.t,
            y=step.y,
            next_step=step.next_step,
            memory=step.memory,
            work=work,
            rows=rows,
            samples=samples,
            frames=frames,
            lowest=lowest,
            highest=highest,
        )

    def state(self) -> MacroState:
        """Everything up to the last step recorded."""
        mark, tally = self._mark, self._right_hand_side.tally
        total = perf_counter() - self._started
        return MacroState(
            t=mark.t,
            y=mark.y.copy(),
            next_step=mark.next_step,
            memory=mark.memory,
            work=mark.work,
            output_t=self._t[: mark.rows].copy(),
            watched=self._watched[: mark.rows].copy(),
            energies=self._energies[:, : mark.rows].copy(),
            dissipation_t=self._sample_t[: mark.samples].copy(),
            dissipation_rate=self._sample_rate[: mark.samples].copy(),
            frame_t=self._frame_t[: mark.frames].copy(),
            frame_displacement=self._frame_nodal[0, : mark.frames].copy(),
            frame_velocity=self._frame_nodal[1, : mark.frames].copy(),
            frame_stress=self._frame_element[0, : mark.frames].copy(),
            frame_F=self._frame_element[1, : mark.frames].copy(),
            lowest=mark.lowest,
            highest=mark.highest,
            nodes=self._bar.nodes,
            load=self._bar.load,
            amplitude=self._amplitude,
            counts={name: tally.counts[name] for name in COUNTS},
            effort=dict(tally.effort),
            wall_time={
                "total": total,
                "law": tally.law_seconds,
                "macro": total - tally.law_seconds,
            },
        )

    def restore(self, state: MacroState) -> None:
        """Go on from where `state` was taken."""
        rows, samples, frames = state.output_t.size, state.dissipation_t.size, state.frame_t.size
        self._watched[:rows] = state.watched
        self._energies[:, :rows] = state.energies
        # A run that began without samples has no dissipation up to here to add to.
        self._record_dissipation = self._record_dissipation and samples > 0
        self._sample_t[:samples] = state.dissipation_t
        self._sample_rate[:samples] = state.dissipation_rate
        self._frame_t[:frames] = state.frame_t
        self._frame_nodal[0, :frames] = state.frame_displacement
        self._frame_nodal[1, :frames] = state.frame_velocity
        self._frame_element[0, :frames] = state.frame_stress
        self._frame_element[1, :frames] = state.frame_F
        self._mark = _Mark(
            t=state.t,
            y=state.y,
            next_step=state.next_step,
            memory=state.memory,
            work=state.work,
            rows=rows,
            samples=samples,
            frames=frames,
            lowest=state.lowest,
            highest=state.highest,
        )

    def _rows_at(self, t: float) -> int:
        """Output times up to t; rounding may put the last one beyond the duration."""
        return self._t.size if t >= self._end else int(np.searchsorted(self._t, t, side="right"))

    def _is_due(self, mark: _Mark, rows: int) -> bool:
        """Whether to sample the dissipation: about every other output time, and at the last."""
        return rows // 2 > mark.rows // 2 or mark.rows < rows == self._t.size

    def _frames_due(self, t: float) -> int:
        return int(np.searchsorted(self._frame_fractions, t, side="right"))

    def _keep_row(self, row: int, step: AcceptedStep, work_before: Array) -> None:
        t = min(self._t[row], step.t)
        u, v = step.interpolate(t).reshape(2, -1, 2)
        self._watched[row] = self._bar.at_watched_point(u)
        self._energies[0, row] = _kinetic(self._bar, v)
        self._energies[1:, row] = work_before + step.work(t)

    def _keep_frame(self, frame: int, evaluation: Evaluation) -> None:
        bar = self._bar
        self._frame_t[frame] = evaluation.t
        self._frame_nodal[0, frame] = bar.on_all_nodes(evaluation.u)
        self._frame_nodal[1, frame] = bar.on_all_nodes(evaluation.v)
        stress = element_mean_stress(bar, evaluation.J, evaluation.response.stress)
        self._frame_element[0, frame] = stress
        self._frame_element[1, frame] = evaluation.F[CENTRE::N_POINTS]


def _kinetic(bar: Bar, v: Array) -> float:
    """½ v·M v, pJ."""
    return 0.5 * float(np.vdot(v, bar.mass @ v))
