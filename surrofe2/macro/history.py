"""The history of a run: recorded step by step, kept as plain arrays that carry the run on."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import clock, cpu_clock
from surrofe2.macro.equations_of_motion import EquationsOfMotion, Evaluation
from surrofe2.macro.frames import NO_EXTREMES, NOTHING, POINTS_EVERY, Frames, widen_extremes
from surrofe2.macro.settings import MacroSettings
from surrofe2.macro.system import System
from surrofe2.macro.time_stepping import Stepper, StepResult
from surrofe2.run.journal import Journal, RunState, frame_series

Array = NDArray[np.float64]

COUNTS = (
    "steps",
    "rejected_steps",
    "failed_trials",
    "repeated_steps",
    "rolled_back_steps",
    "right_hand_sides",
    "factorisations",
    "stress_calls",
    "stress_points",
    "dissipation_points",
    "dissipation_failures",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class MacroState(RunState):
    """A run at the end of a step: all that carries it on, and all it has recorded.

    Attributes:
        t: µs. y: (2 m,) displacement and velocity of the free unknowns.
        next_step: length proposed for the next step, µs.
        memory: what the integrator knows besides y; empty if and only if it is the explicit one.
        work: (k,) since t = 0 of what `Evaluation.powers` lists, pJ.
        journal: ``rows`` (r, c) at the output times passed, the columns of `columns_of`;
            ``samples`` (s, 1 + k) t and rates of dissipation of `System.dissipating`, µs and pJ/µs,
            at ends of steps; ``frames.…`` as of `Frames`.
        dissipated: (2, n_el) energy up to the last sample, pJ, and the rate there.
        extremes: (2, 4, 2, 2) lowest and highest entries of F, Ḟ, U and RᵀḞ.
        identity: (k, 32) digests of the problem's parts; a resumed run must have the same.
        counts, effort, wall_time: as in `MacroRun`.
        stress: (n_points, 2, 2) by which the next step begins, µN/µm.
        law_state: what the law has committed; None: it starts cold.
        rest: as `System.rest`; (0, 2) of None.
        mark: where the run goes back to if what follows does not stand, without the law's state,
            which the law knows; None: it never does.
    """

    SERIES: ClassVar[tuple[str, ...]] = (
        "rows", "samples", *(f"frames.{item.name}" for item in fields(Frames))
    )  # fmt: skip

    t: float
    y: Array
    next_step: float
    memory: Array
    work: Array
    journal: Journal
    dissipated: Array
    extremes: Array
    identity: Array
    counts: dict[str, int]
    effort: dict[str, int]
    wall_time: dict[str, float]
    stress: Array
    law_state: Any = None
    rest: Array = field(default_factory=lambda: np.empty((0, 2)))
    mark: MacroState | None = None

    @property
    def frames(self) -> Frames:
        """Whole fields at a few times."""
        return Frames(**self.journal.part("frames"))

    def copy(self) -> MacroState:
        """The same with memory of its own for what it has recorded."""
        mark = None if self.mark is None else self.mark.copy()
        return replace(self, journal=self.journal.copy(), mark=mark)


def columns_of(system: System) -> list[str]:
    """What a row of a run's history holds, in its order.

    t; for each watched point its displacement; for each boundary its mean displacement; for each
    support, surface load and body the force it exerts on the tissue; for each body its
    displacement and the depth of the deepest penetration; kinetic energy; works.
    """
    vectors = [f"displacement {name}" for name in system.problem.watched]
    vectors += [f"mean displacement {name}" for name in system.boundaries]
    vectors += [f"force {name}" for name in system.force_names]
    vectors += [f"position {contact.name}" for contact in system.contacts]
    both = [f"{name} {axis}" for name in vectors for axis in "xy"]
    depths = [f"penetration {contact.name}" for contact in system.contacts]
    works = ["internal", *(force.name for force in system.forces), "motion", "inertia"]
    return ["t", *both, *depths, "contact", "kinetic", *(f"work {name}" for name in works)]


class Recorder:
    """Records a run in a state that is replaced as a whole, so that no interrupt can tear it."""

    def __init__(
        self,
        equations: EquationsOfMotion,
        settings: MacroSettings,
        resume: MacroState | None = None,
        begin: float | None = None,
    ) -> None:
        self._equations, self._system = equations, equations.system
        problem = self._system.problem
        self.end = problem.duration
        self._t = problem.output_times()
        self._frame_fractions = np.linspace(0.0, problem.duration, settings.frames)
        # A run that began without samples has no dissipation up to here to add to.
        self._record_dissipation = settings.record_dissipation and (
            resume is None or len(resume.journal["samples"]) > 0
        )
        begin = clock() if begin is None else begin
        self._started = begin - (resume.wall_time["total"] if resume else 0.0)
        self._cpu_started = cpu_clock() - (resume.wall_time.get("cpu", 0.0) if resume else 0.0)
        self._state: MacroState
        if resume is not None:
            self._state = resume.copy()

    def begin(self, stepper: Stepper, work: Array) -> None:
        """Record the start; `work` is that of the jump of prescribed velocities there."""
        start = stepper.now
        extremes = NO_EXTREMES.copy()
        widen_extremes(extremes, start.F, start.F_dot)
        sample, dissipated = NOTHING, np.zeros((2, len(self._system.discretisation.elements)))
        if self._record_dissipation:
            sample, dissipated = self._sampled(NOTHING, dissipated, start)
            self._record_dissipation = sample.size > 0
        samples = sample.reshape(-1, 1 + len(self._system.dissipating))
        rows = {"rows": self._row(start.t, start.y, work, self._forces(start))[None]}
        rows |= {"samples": samples} | self._frame(start, samples, dissipated)
        self._state = MacroState(
            t=start.t,
            y=start.y,
            next_step=stepper.next_length,
            memory=stepper.memory,
            work=work,
            journal=Journal.of(rows),
            dissipated=dissipated,
            extremes=extremes,
            identity=self._system.identity(),
            rest=np.empty((0, 2)) if self._system.rest is None else self._system.rest,
            **self._standing(stepper),
        )

    def record(self, step: StepResult, stepper: Stepper) -> None:
        """Record an accepted step, after which `stepper` stands at its end."""
        before, end = self._state, step.end
        journal, dissipated = before.journal, before.dissipated
        passed, due = journal.lengths["rows"], self._rows_due(end.t)
        if due > passed:
            first, last = self._forces(step.start), self._forces(end)
            for t in self._t[passed:due]:
                within = min(t, end.t)
                part = (within - step.start.t) / step.length
                forces = (1.0 - part) * first + part * last
                work = before.work + step.work(within)
                row = self._row(t, step.interpolate(within), work, forces)
                journal = journal.written({"rows": row[None]})
        # About every other output time, and at the last.
        if self._record_dissipation and (due // 2 > passed // 2 or passed < due == self._t.size):
            sample, dissipated = self._sampled(journal["samples"], dissipated, end)
            if sample.size:
                journal = journal.written({"samples": sample[None]})
        if self._frames_due(end.t) > self._frames_due(step.start.t):
            journal = journal.written(self._frame(end, journal["samples"], dissipated))
        extremes = before.extremes.copy()
        widen_extremes(extremes, end.F, end.F_dot)
        self._state = replace(
            before,
            t=end.t,
            y=end.y,
            next_step=stepper.next_length,
            memory=stepper.memory,
            work=before.work + step.work(end.t),
            journal=journal,
            dissipated=dissipated,
            extremes=extremes,
            **self._standing(stepper),
        )

    @property
    def t(self) -> float:
        """Of the last step recorded, µs."""
        return self._state.t

    def mark(self) -> None:
        """What was recorded so far stands."""
        marked = replace(self._state, law_state=None, mark=None)
        self._state = replace(self._state, mark=marked)

    def go_back(self) -> MacroState:
        """The state at the mark, by the law's state as it is now; what was spent stays spent."""
        mark, counts = self._state.mark, self._equations.tally.counts
        assert mark is not None
        counts["rolled_back_steps"] += counts["steps"] - mark.counts["steps"]
        counts["steps"] = mark.counts["steps"]
        law_state = self._equations.law_state
        self._state = replace(mark, law_state=law_state, mark=mark, **self._cost())
        return self._state

    @property
    def may_be_kept(self) -> bool:
        """Not in a step that the law is asked to commit: it may have taken down a part of it."""
        return not self._equations.is_committing

    def checkpoint(self) -> MacroState:
        """The state after the last step recorded, without what the next one has cost so far."""
        return replace(self._state, wall_time=self._cost()["wall_time"]).copy()

    def state(self) -> MacroState:
        """Everything up to the last step recorded, with all that was spent."""
        return replace(self._state, **self._cost())

    def _standing(self, stepper: Stepper) -> dict[str, Any]:
        """What changes with every step and is not of its motion."""
        stress = stepper.now.response.stress
        return {"stress": stress, "law_state": self._equations.law_state, **self._cost()}

    def _cost(self) -> dict[str, Any]:
        tally, total = self._equations.tally, clock() - self._started
        law = tally.law_seconds
        return {
            "counts": {name: tally.counts[name] for name in COUNTS},
            "effort": dict(tally.effort),
            "wall_time": {
                "total": total,
                "law": law,
                "macro": total - law,
                "cpu": cpu_clock() - self._cpu_started,
            },
        }

    def _rows_due(self, t: float) -> int:
        """Output times up to t; rounding may put the last one beyond the duration."""
        return self._t.size if t >= self.end else int(np.searchsorted(self._t, t, side="right"))

    def _frames_due(self, t: float) -> int:
        return int(np.searchsorted(self._frame_fractions, t, side="right"))

    def _sampled(self, samples: Array, dissipated: Array, now: Evaluation) -> tuple[Array, Array]:
        """Time and rate of dissipation of each region, and `MacroState.dissipated` there; nothing
        and the same as before where it is not known.
        """
        # At rest nothing dissipates.
        still = np.zeros(dissipated.shape[1])
        rates = still if not now.v.any() else self._equations.dissipation_rates(now)
        if rates is None:
            return NOTHING, dissipated
        by_region = [rates[elements].sum() for elements in self._system.regions.values()]
        surface = self._system.surface
        if surface is not None:
            by_region += [*surface.dissipation_rates(now.u, now.v)]
        energy, before = dissipated
        since = now.t - samples[-1, 0] if len(samples) else 0.0
        energy = energy + 0.5 * since * (before + rates)
        return np.array([now.t, *by_region]), np.stack([energy, rates])

    def _forces(self, now: Evaluation) -> Array:
        """(k, 2) forces on the tissue by supports, surface loads and bodies, µN."""
        return self._system.resultants(now.forces, self._equations.reaction(now))

    def _row(self, t: float, y: Array, work: Array, forces: Array) -> Array:
        """What `columns_of` lists, with the kinetic energy ½ v·M v."""
        system = self._system
        u, v = system.spread(y, t, self._equations.within)
        kinetic = 0.5 * np.vdot(v, system.mass @ v)
        bodies = u[len(system.discretisation.nodes) :]
        vectors = [system.at_watched_points(u), system.mean_displacements(u), forces, bodies]
        depths = [contact.penetration(u) for contact in system.contacts]
        stored = sum(contact.energy(u) for contact in system.contacts)
        flat = [part.ravel() for part in vectors]
        return np.concatenate([[t], *flat, depths, [stored, kinetic], work])

    def _frame(self, now: Evaluation, samples: Array, dissipated: Array) -> dict[str, Array]:
        answer, space = now.response, self._system.discretisation
        sources = None if answer.sources is None else answer.sources()
        density = NOTHING
        if self._record_dissipation:
            density = (dissipated[0] + (now.t - samples[-1, 0]) * dissipated[1]) / space.areas
        motion, due = (now.u, now.v), self._frames_due(now.t)
        kept = (due - 1) % POINTS_EVERY == 0 or now.t >= self.end
        frame = Frames.of(space, now.t, motion, now.F, answer.stress, sources, density, points=kept)
        return frame_series(frame)
