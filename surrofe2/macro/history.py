"""The history of a run: recorded step by step, kept as plain arrays that carry the run on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass, fields, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.errors import InputError
from surrofe2.load_case import LoadCase
from surrofe2.macro.discretisation import CENTRE, N_POINTS, Discretisation
from surrofe2.macro.equations_of_motion import EquationsOfMotion, Evaluation
from surrofe2.macro.internal_force import element_mean_stress
from surrofe2.macro.settings import MacroSettings
from surrofe2.macro.time_stepping import Stepper, StepResult

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

    @classmethod
    def of(
        cls, discretisation: Discretisation, t: float, u: Array, v: Array, F: Array, stress: Array
    ) -> Frames:
        """Those of one time, from unknowns (n_free, 2) and values at the points."""
        mean_stress = element_mean_stress(discretisation, F, stress)
        return cls(
            t=np.array([t]),
            displacement=discretisation.on_all_nodes(u)[None],
            velocity=discretisation.on_all_nodes(v)[None],
            stress=mean_stress[None],
            F=F[None, CENTRE::N_POINTS],
        )

    def followed_by(self, other: Frames) -> Frames:
        """Both, one after the other."""
        pairs = zip(astuple(self), astuple(other), strict=True)
        return Frames(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True, slots=True, kw_only=True)
class MacroState:
    """A run at the end of a step: all that carries it on, and all it has found.

    Plain arrays, numbers and dicts, none of which is changed any more, and the law's state, which
    is whatever the law makes it: who writes a file adds it to the arrays by the law's own means.

    Attributes:
        t: µs. y: (4 n_free,) displacement and velocity of the free nodes.
        next_step: length proposed for the next step, µs.
        memory: what the integrator knows besides y; empty if and only if it is the explicit one.
        work: (2,) internal and load work since t = 0, pJ.
        rows: (r, 6) at the output times passed: t, displacement of the watched point, kinetic
            energy, internal and load work.
        samples: (s, 2) t and rate of dissipation, µs and pJ/µs, at ends of steps.
        frames: whole fields.
        extremes: (2, 4, 2, 2) lowest and highest entries of F, Ḟ, U and RᵀḞ.
        nodes, load, amplitude: what the run was of; a resumed run must have the same.
        counts, effort, wall_time: as in `MacroRun`.
        stress: (n_points, 2, 2) by which the next step begins, µN/µm.
        law_state: what the law has committed; None: it starts cold.
    """

    t: float
    y: Array
    next_step: float
    memory: Array
    work: Array
    rows: Array
    samples: Array
    frames: Frames
    extremes: Array
    nodes: Array
    load: Array
    amplitude: Array
    counts: dict[str, int]
    effort: dict[str, int]
    wall_time: dict[str, float]
    stress: Array
    law_state: Any = None

    def to_arrays(self) -> dict[str, NDArray]:
        """One array for each entry; those of frames and dicts are ``"counts.steps"`` and so on."""
        arrays: dict[str, NDArray] = {}
        values = asdict(replace(self, law_state=None))
        del values["law_state"]
        for name, value in values.items():
            inner = value.items() if isinstance(value, dict) else ()
            arrays |= {f"{name}.{key}": np.array(entry) for key, entry in inner}
            if not isinstance(value, dict):
                arrays[name] = np.array(value)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> MacroState:
        """The state whose `to_arrays` gave `arrays`.

        Raises:
            InputError: one of them is missing.
        """
        values: dict[str, Any] = {"frames": {}, "counts": {}, "effort": {}, "wall_time": {}}
        for name, array in arrays.items():
            value = array.item() if np.ndim(array) == 0 else np.array(array, dtype=np.float64)
            group, dot, key = name.partition(".")
            (values[group] if dot else values)[key or name] = value
        for of, found, prefix in ((cls, values, ""), (Frames, values["frames"], "frames.")):
            for item in fields(of):
                if item.name not in found and item.name != "law_state":
                    raise InputError(
                        f"macro state: no '{prefix}{item.name}'; the checkpoint is incomplete"
                    )
        return cls(**values | {"frames": Frames(**values["frames"])})


@dataclass(frozen=True, slots=True)
class MetRange:
    """Lowest and highest entries that any point met at the end of any step, (2, 2, 2) each.

    With F = R U: a sampling range over (U, RᵀḞ) that holds these holds the run.
    """

    F: Array
    F_dot: Array
    U: Array
    RT_F_dot: Array

    @classmethod
    def of(cls, extremes: Array) -> MetRange:
        """From lowest and highest entries as `widen_extremes` has them."""
        return cls(*extremes.swapaxes(0, 1))

    def to_dict(self) -> dict[str, Any]:
        """The extremes, and `stretch`, `shear`, `rate` of the sampling range that holds them."""
        bounds = {"stretch": self.stretch, "shear": self.shear, "rate": self.rate}
        return asdict(self) | bounds

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
        return float(max(high.max(), -low.min()))


class Recorder:
    """Records a run in a state that is replaced as a whole, so that no interrupt can tear it."""

    def __init__(
        self,
        equations: EquationsOfMotion,
        load_case: LoadCase,
        settings: MacroSettings,
        resume: MacroState | None = None,
    ) -> None:
        self._equations = equations
        self._discretisation = equations.discretisation
        self._end = load_case.duration
        self._amplitude = np.array(load_case.amplitude, dtype=np.float64).reshape(-1, 2)
        self._t = load_case.output_times()
        self._frame_fractions = np.linspace(0.0, load_case.duration, settings.frames)
        # A run that began without samples has no dissipation up to here to add to.
        self._record_dissipation = settings.record_dissipation and (
            resume is None or len(resume.samples) > 0
        )
        self._started = perf_counter() - (resume.wall_time["total"] if resume else 0.0)
        self._state: MacroState
        if resume is not None:
            self._state = resume

    def begin(self, stepper: Stepper) -> None:
        """Record the state at rest at t = 0."""
        start = stepper.now
        extremes = NO_EXTREMES.copy()
        widen_extremes(extremes, start.F, start.F_dot)
        self._state = MacroState(
            t=start.t,
            y=start.y,
            next_step=stepper.next_length,
            memory=stepper.memory,
            work=np.zeros(2),
            rows=self._row(start.t, start.y, np.zeros(2))[None],
            # At rest nothing dissipates.
            samples=np.zeros((1 if self._record_dissipation else 0, 2)),
            frames=self._frame(start),
            extremes=extremes,
            nodes=self._discretisation.nodes,
            load=self._discretisation.load,
            amplitude=self._amplitude,
            **self._standing(stepper),
        )
        self._equations.is_committing = False

    def record(self, step: StepResult, stepper: Stepper) -> None:
        """Record an accepted step, after which `stepper` stands at its end."""
        before, end = self._state, step.end
        passed, due = len(before.rows), self._rows_due(end.t)
        rows, samples, frames = [before.rows], before.samples, before.frames
        for t in self._t[passed:due]:
            within = min(t, end.t)
            work = before.work + step.work(within)
            rows.append(self._row(t, step.interpolate(within), work)[None])
        # About every other output time, and at the last.
        if self._record_dissipation and (due // 2 > passed // 2 or passed < due == self._t.size):
            rate = self._equations.dissipation_rate(end)
            if not np.isnan(rate):
                samples = np.vstack([samples, [end.t, rate]])
        if self._frames_due(end.t) > self._frames_due(step.start.t):
            frames = frames.followed_by(self._frame(end))
        extremes = before.extremes.copy()
        widen_extremes(extremes, end.F, end.F_dot)
        self._state = replace(
            before,
            t=end.t,
            y=end.y,
            next_step=stepper.next_length,
            memory=stepper.memory,
            work=before.work + step.work(end.t),
            rows=np.concatenate(rows),
            samples=samples,
            frames=frames,
            extremes=extremes,
            **self._standing(stepper),
        )
        self._equations.is_committing = False

    def checkpoint(self) -> MacroState:
        """The state after the last step recorded, without what the next one has cost so far."""
        return replace(self._state, wall_time=self._cost()["wall_time"])

    def state(self) -> MacroState:
        """Everything up to the last step recorded, with all that was spent."""
        return replace(self._state, **self._cost())

    def _standing(self, stepper: Stepper) -> dict[str, Any]:
        """What changes with every step and is not of its motion."""
        stress = stepper.now.response.stress
        return {"stress": stress, "law_state": self._equations.law_state, **self._cost()}

    def _cost(self) -> dict[str, Any]:
        tally, total = self._equations.tally, perf_counter() - self._started
        law = tally.law_seconds
        return {
            "counts": {name: tally.counts[name] for name in COUNTS},
            "effort": dict(tally.effort),
            "wall_time": {"total": total, "law": law, "macro": total - law},
        }

    def _rows_due(self, t: float) -> int:
        """Output times up to t; rounding may put the last one beyond the duration."""
        return self._t.size if t >= self._end else int(np.searchsorted(self._t, t, side="right"))

    def _frames_due(self, t: float) -> int:
        return int(np.searchsorted(self._frame_fractions, t, side="right"))

    def _row(self, t: float, y: Array, work: Array) -> Array:
        """t, displacement of the watched point, kinetic energy ½ v·M v, and work."""
        u, v = y.reshape(2, -1, 2)
        kinetic = 0.5 * np.vdot(v, self._discretisation.mass @ v)
        return np.concatenate([[t], self._discretisation.at_watched_point(u), [kinetic], work])

    def _frame(self, now: Evaluation) -> Frames:
        return Frames.of(self._discretisation, now.t, now.u, now.v, now.F, now.response.stress)


NO_EXTREMES = np.broadcast_to([[[[np.inf]]], [[[-np.inf]]]], (2, 4, 2, 2))
"""Of no point yet."""


@kernel
def widen_extremes(extremes: Any, F: Any, F_dot: Any) -> None:
    """Widen (2, 4, 2, 2) lowest and highest values by F, Ḟ, U = RᵀF and RᵀḞ of all points.

    R is the rotation of the polar decomposition, cos θ : sin θ = F₁₁ + F₂₂ : F₂₁ − F₁₂.
    """
    values = np.empty((4, 2, 2))
    for p in range(F.shape[0]):
        c, s = F[p, 0, 0] + F[p, 1, 1], F[p, 1, 0] - F[p, 0, 1]
        norm = np.sqrt(c * c + s * s)
        c, s = c / norm, s / norm
        for j in range(2):
            for i in range(2):
                values[0, i, j] = F[p, i, j]
                values[1, i, j] = F_dot[p, i, j]
            for k in range(2):
                values[2 + k, 0, j] = c * values[k, 0, j] + s * values[k, 1, j]
                values[2 + k, 1, j] = c * values[k, 1, j] - s * values[k, 0, j]
        for k in range(4):
            for i in range(2):
                for j in range(2):
                    extremes[0, k, i, j] = min(extremes[0, k, i, j], values[k, i, j])
                    extremes[1, k, i, j] = max(extremes[1, k, i, j], values[k, i, j])
