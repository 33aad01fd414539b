"""The history of a run: rows, extremes and whole fields, kept as arrays that carry the run on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np

from surrofe2.base.arrays import Array, Flags
from surrofe2.base.clock import clock, cpu_clock
from surrofe2.base.compilation import kernel
from surrofe2.base.simd import TILE, load, root, store, where_less
from surrofe2.law.bifurcation import beyond_bifurcation, count_beyond
from surrofe2.law.stress_law import Sources
from surrofe2.macro.audits import Report, RunAudits
from surrofe2.macro.elements import (
    Discretisation,
    element_mean_F,
    element_mean_stress,
)
from surrofe2.macro.equations_of_motion import EquationsOfMotion, Evaluation
from surrofe2.macro.settings import MacroSettings
from surrofe2.macro.system import System
from surrofe2.macro.time_stepping import Stepper, StepResult
from surrofe2.run.journal import BEYOND, CROSSINGS, Journal, RunState, frame_series

NO_EXTREMES = np.broadcast_to([[[[np.inf]]], [[[-np.inf]]]], (2, 4, 2, 2))
"""Of no point yet."""


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


@kernel
def widen_extremes(extremes: Any, F: Any, F_dot: Any) -> None:
    """Widen (2, 4, 2, 2) lowest and highest values by F, Ḟ, U = RᵀF and RᵀḞ of all points.

    R is the rotation of the polar decomposition, cos θ : sin θ = F₁₁ + F₂₂ : F₂₁ − F₁₂. Eight
    points are taken at once; behind the last one it is repeated.
    """
    values = np.empty((16, TILE))
    low = np.empty((16, TILE))
    high = np.empty((16, TILE))
    for k in range(16):
        low[k, :] = extremes[0, k // 4, k // 2 % 2, k % 2]
        high[k, :] = extremes[1, k // 4, k // 2 % 2, k % 2]
    for start in range(0, F.shape[0], TILE):
        for lane in range(TILE):
            p = np.uint64(min(start + lane, F.shape[0] - 1))
            for k in range(4):
                values[k, lane] = F[p, k // 2, k % 2]
                values[4 + k, lane] = F_dot[p, k // 2, k % 2]
        c = load(values, 0) + load(values, 3)
        s = load(values, 2) - load(values, 1)
        norm = root(c * c + s * s)
        c = c / norm
        s = s / norm
        for k in range(0, 8, 4):
            for j in range(2):
                x = load(values, k + j)
                y = load(values, k + 2 + j)
                store(c * x + s * y, values, 8 + k + j)
                store(c * y - s * x, values, 10 + k + j)
        for k in range(16):
            value = load(values, k)
            lowest = load(low, k)
            highest = load(high, k)
            store(where_less(value, lowest, value, lowest), low, k)
            store(where_less(highest, value, value, highest), high, k)
    for k in range(16):
        extremes[0, k // 4, k // 2 % 2, k % 2] = low[k].min()
        extremes[1, k // 4, k // 2 % 2, k % 2] = high[k].max()


NOTHING: Array = np.empty(0)
POINTS_EVERY = 10
"""Points of the law are kept at each frame whose number this divides, and at the last."""


@dataclass(frozen=True, slots=True)
class Frames:
    """Whole fields at k times, each the end of the first step that passed an even fraction of the
    duration: there the stress is the one the run went on with, and nothing is interpolated.

    Attributes:
        t: (k,) µs, increasing, from 0 to the end.
        displacement, velocity: (k, n_nodes, 2) µm and µm/µs.
        stress: (k, n_el, 2, 2) element mean of the Cauchy stress, µN/µm.
        F, F_dot: (k, n_el, 2, 2) element mean of the deformation gradient, and of its rate, 1/µs.
        source, risk: (k, n_el) of `Sources`, the largest of the element's points; (k, 0) of a law
            that does not tell.
        beyond: (k, n_el) 1 where a point of the element is beyond a bifurcation, else 0; (k, 0) of
            a law that cannot tell.
        dissipated: (k, n_el) energy by reference area since t = 0, pJ/µm²; (k, 0) if not recorded.
            Between the samples of `MacroState` the rate counts as the one of the last.
        point_t: (p,) µs, those of t at which the law's points are kept too: a tenth of them.
        point_stress: (p, n_points, 2, 2) Cauchy stress as the law answered, µN/µm.
        point_source, point_risk: (p, n_points) of `Sources`; (p, 0) of a law that does not tell.
    """

    t: Array
    displacement: Array
    velocity: Array
    stress: Array
    F: Array
    F_dot: Array
    source: Array
    risk: Array
    beyond: Array
    dissipated: Array
    point_t: Array
    point_stress: Array
    point_source: Array
    point_risk: Array

    def one_by_one(self) -> Iterator[Frames]:
        """Each of them alone, with its points where they are kept."""
        point = 0
        for k, t in enumerate(self.t):
            row = slice(k, k + 1)
            points = slice(point, point)
            if point < len(self.point_t) and self.point_t[point] == t:
                points = slice(point, point + 1)
                point += 1
            values = {item.name: getattr(self, item.name) for item in fields(self)}
            yield Frames(
                **{
                    name: each[points if name.startswith("point_") else row]
                    for name, each in values.items()
                }
            )

    @classmethod
    def of(
        cls,
        space: Discretisation,
        now: Evaluation,
        sources: Sources | None = None,
        dissipated: Array = NOTHING,
        *,
        beyond: Flags | None = None,
        points: bool = True,
    ) -> Frames:
        """Those of one state, with values at the points if asked for, `dissipated` (n_el,), and
        which points (n_points,) are beyond a bifurcation."""
        n = len(space.nodes)
        stress = now.response.stress
        known = np.empty((2, 0))
        if sources is not None:
            known = np.stack([sources.source, sources.risk]).astype(np.float64)
        largest = known.reshape(2, len(space.elements), -1).max(axis=2) if known.size else known
        kept = slice(0, int(points))  # of the only row
        return cls(
            t=np.array([now.t]),
            displacement=now.u[None, :n],
            velocity=now.v[None, :n],
            stress=element_mean_stress(space, now.F, stress)[None],
            F=element_mean_F(space, now.F)[None],
            F_dot=element_mean_F(space, now.F_dot)[None],
            source=largest[:1],
            risk=largest[1:],
            beyond=_in_elements(space, beyond)[None],
            dissipated=dissipated[None],
            point_t=np.array([now.t])[kept],
            point_stress=stress[None][kept],
            point_source=known[:1][kept],
            point_risk=known[1:][kept],
        )


def _in_elements(space: Discretisation, flags: Flags | None) -> Array:
    """(n_el,) 1 where a point of the element is flagged, else 0; (0,) of None."""
    if flags is None:
        return NOTHING
    in_element = flags.reshape(len(space.elements), -1).any(axis=1)
    return np.where(in_element, 1.0, 0.0)


KeepFrame = Callable[[Frames, int, int], None]
"""Takes whole fields at one time, with how many frames and frames of points there are before it. A
frame whose number was there already replaces that and those behind it."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class MacroState(RunState):
    """A run at the end of a step: all that carries it on, and all it has recorded.

    Attributes:
        t: µs. y: (2 m,) displacement and velocity of the free unknowns.
        next_step: length proposed for the next step, µs.
        memory: what the integrator knows besides y; empty if and only if it is the explicit one.
        work: since t = 0, a row of `Works`, pJ.
        journal: ``rows`` (r, c) at the output times passed, the columns of `columns_of`;
            ``samples`` (s, 1 + k) t and rates of dissipation of `System.dissipating`, µs and pJ/µs,
            at ends of steps; ``frames.…`` as of `Frames`.
        dissipated: (2, n_el) energy up to the last sample, pJ, and the rate there.
        extremes: (2, 4, 2, 2) lowest and highest entries of F, Ḟ, U and RᵀḞ.
        largest_displacement: of all nodes at ends of steps so far, µm.
        identity: by name, digests of the problem's parts; a resumed run must have the same.
        counts, effort, rolled_back, wall_time: as in `MacroRun`.
        stress: (n_points, 2, 2) by which the next step begins, µN/µm.
        law_state: what the law has committed; None: it starts cold.
        rest: as `System.rest`; (0, 2) of None.
        drags: by body whose points stick, friction of the springs, µN/µm.
        mark: where the run goes back to if what follows does not stand, without the law's state,
            which the law knows; None: it never does."""

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
    largest_displacement: float
    identity: dict[str, Array]
    counts: dict[str, int]
    effort: dict[str, int]
    rolled_back: dict[str, int]
    wall_time: dict[str, float]
    stress: Array
    law_state: Any = None
    rest: Array = field(default_factory=lambda: np.empty((0, 2)))
    drags: dict[str, Array] = field(default_factory=dict)
    mark: MacroState | None = None

    @property
    def frames(self) -> Frames:
        """Whole fields at a few times."""
        return Frames(**self.journal.part("frames"))

    def copy(self) -> MacroState:
        """The same with memory of its own for what it has recorded."""
        mark = None if self.mark is None else self.mark.copy()
        return replace(self, journal=self.journal.copy(), mark=mark)


def columns_of(system: System, *, in_time: bool) -> list[str]:
    """Return the names of what a row of a run's history holds, in its order.

    t; for each watched point its displacement; for each boundary its mean displacement; for each
    support, surface load and body the force it exerts on the tissue; for each body its
    displacement and the depth of the deepest penetration; how many points are beyond a bifurcation;
    how many outer sides cross; energy stored in contact; kinetic energy; works; in time the impulse
    of each body on the tissue.
    """
    vectors = [*system.probe_names]
    vectors += [f"force {name}" for name in system.force_names]
    vectors += [f"position {contact.name}" for contact in system.contacts]
    both = [f"{name} {axis}" for name in vectors for axis in "xy"]
    depths = [f"penetration {contact.name}" for contact in system.contacts]
    works = [f"work {name}" for name in system.names_of_works]
    last = [BEYOND, CROSSINGS, "contact", "kinetic", *works]
    impulses = [f"impulse {name}" for name in system.names_of_impulses] if in_time else []
    return ["t", *both, *depths, *last, *impulses]


def row_of(
    system: System, t: float, motion: tuple[Array, Array], forces: Array, beyond: float, work: Array
) -> Array:
    """Return what `columns_of` lists, with the kinetic energy ½ v·M v.

    Args:
        t: µs, or the factor of the load.
        motion: displacement and velocity (n, 2) of all nodes and bodies.
        forces: (k, 2) of `System.force_names`, µN.
        beyond: points beyond a bifurcation; NaN where the law cannot tell.
        work: a row of `Works`, pJ.
    """
    u, v = motion
    kinetic = 0.5 * np.vdot(v, system.inertia(v))
    bodies = u[len(system.discretisation.nodes) :]
    vectors = [system.probes @ u, forces, bodies]
    depths = [contact.penetration(u) for contact in system.contacts]
    stored = sum(contact.energy(u) for contact in system.contacts)
    flat = [part.ravel() for part in vectors]
    x = system.discretisation.nodes + system.from_mesh(u)[: len(system.discretisation.nodes)]
    crossings = system.outer_sides.crossings(x)
    return np.concatenate([[t], *flat, depths, [beyond, crossings, stored, kinetic], work])


class Recorder:
    """Records a run in a state that is replaced as a whole, so that no interrupt can tear it."""

    def __init__(
        self,
        equations: EquationsOfMotion,
        settings: MacroSettings,
        resume: MacroState | None = None,
        begin: float | None = None,
        keep_frame: KeepFrame | None = None,
    ) -> None:
        self._equations = equations
        self._system = equations.system
        self._keep_frame = keep_frame
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
        law_state, t = (None, 0.0) if resume is None else (resume.law_state, resume.t)
        self._audits = RunAudits(equations, law_state, t)
        self._state: MacroState
        if resume is not None:
            self._state = resume.copy()

    def begin(self, stepper: Stepper, work: Array) -> None:
        """Record the start; `work` is that of the jump of prescribed velocities there."""
        now = stepper.now
        system = self._system
        state = MacroState(
            journal=Journal.of({"rows": self._row(now.t, now.y, work, self._forces(now))[None]}),
            dissipated=np.zeros((2, len(system.discretisation.elements))),
            extremes=NO_EXTREMES,
            largest_displacement=0.0,
            identity=system.identity(),
            rest=np.empty((0, 2)) if system.rest is None else system.rest,
            rolled_back={},
            wall_time=self._seconds(),
            **self._end_of_step(stepper, work),
        )
        journal = state.journal.written({"samples": np.empty((0, 1 + len(system.dissipating)))})
        recorded = self._fields(state, journal, now, is_sample=True, is_frame=True)
        self._state = replace(state, **recorded, **self._spent())
        self._record_dissipation &= len(self._state.journal["samples"]) > 0

    def record(self, step: StepResult, stepper: Stepper) -> None:
        """Record an accepted step, after which `stepper` stands at its end."""
        before = self._state
        end = step.end
        journal = before.journal
        begin = step.start.t
        passed = journal.lengths["rows"]
        due = int(np.searchsorted(self._t, end.t, side="right"))
        if end.t >= self.end:
            due = self._t.size  # rounding may put the last one beyond the duration
        if due > passed:
            first = self._forces(step.start)
            last = self._forces(end)
            for t in self._t[passed:due]:
                within = min(t, end.t)
                part = (within - begin) / step.length
                forces = (1.0 - part) * first + part * last
                work = before.work + step.work(within)
                row = self._row(t, step.interpolate(within), work, forces)
                journal = journal.written({"rows": row[None]})
        is_frame = self._frames_due(end.t) > self._frames_due(begin)
        # Dissipation, which costs another call of the law, about every other output time.
        is_sample = due // 2 > passed // 2 or passed < due == self._t.size
        work = before.work + step.work(end.t)
        recorded = self._fields(before, journal, end, is_sample=is_sample, is_frame=is_frame)
        self._state = replace(before, **recorded, **self._end_of_step(stepper, work))

    def _end_of_step(self, stepper: Stepper, work: Array) -> dict[str, Any]:
        """Return where the run stands, and what it has spent so far, but for the seconds."""
        return {
            "t": stepper.now.t,
            "y": stepper.now.y,
            "next_step": stepper.next_length,
            "memory": stepper.memory,
            "work": work,
            "stress": stepper.now.response.stress,
            "law_state": self._equations.law_state,
            "drags": self._equations.system.drags,
            **self._spent(),
        }

    def _fields(
        self,
        state: MacroState,
        journal: Journal,
        now: Evaluation,
        *,
        is_sample: bool,
        is_frame: bool,
    ) -> dict[str, Any]:
        """The journal, dissipation and extremes of a state, with those at `now` where due."""
        energy, before = state.dissipated
        if is_sample and self._record_dissipation:
            # At rest nothing dissipates.
            rates = self._equations.dissipation_rates(now) if now.v.any() else 0.0 * before
            if rates is not None:
                samples = journal["samples"]
                since = now.t - samples[-1, 0] if len(samples) else 0.0
                energy = energy + 0.5 * since * (before + rates)
                before = rates
                surface = self._system.surface
                regions = self._system.regions.values()
                sides = () if surface is None else surface.dissipation_rates(now.u, now.v)
                row = [now.t, *(rates[elements].sum() for elements in regions), *sides]
                journal = journal.written({"samples": np.array([row])})
        if is_frame:
            density = NOTHING
            samples = journal["samples"]
            space = self._system.discretisation
            if len(samples):
                density = (energy + (now.t - samples[-1, 0]) * before) / space.areas
            sources = None if now.response.sources is None else now.response.sources()
            kept = (self._frames_due(now.t) - 1) % POINTS_EVERY == 0 or now.t >= self.end
            equations = self._equations
            beyond = beyond_bifurcation(equations.law, equations.law_state)
            frame = Frames.of(space, now, sources, density, beyond=beyond, points=kept)
            if self._keep_frame is not None:
                lengths = journal.lengths
                counts = lengths.get("frames.t", 0), lengths.get("frames.point_t", 0)
                self._keep_frame(frame, *counts)
            times_alone = self._keep_frame is not None
            journal = journal.written(frame_series(frame, times_alone=times_alone))
        extremes = state.extremes.copy()
        widen_extremes(extremes, now.F, now.F_dot)
        largest = float(np.sqrt((now.u**2).sum(axis=1).max()))
        return {
            "journal": journal,
            "dissipated": np.stack([energy, before]),
            "extremes": extremes,
            "largest_displacement": max(state.largest_displacement, largest),
        }

    @property
    def t(self) -> float:
        """Time of the last step recorded, µs."""
        return self._state.t

    def watch(self, resume: MacroState | None) -> None:
        """From here on an audited law is asked after every step whether what was recorded stands;
        the window of the state that the run continues from does so, too, where the law knows it.
        """
        if self._audits.watch(has_mark=resume is not None and resume.mark is not None):
            self._mark()

    def settle(self, *, final: bool = False) -> MacroState | None:
        """The state to go back to where the steps since the mark do not stand, else None.

        final: no step follows, or none can.
        """
        return self._audits.settle(self.t, self._mark, self._go_back, final=final)

    def close(self, closing: Callable[[int, int], None] | None) -> bool:
        """Solve a batch of the law's closing audit; see `RunAudits.close`."""
        return self._audits.close(closing)

    def report(self, *, finished: bool) -> Report:
        """Return the report of an audited law on this run; see `RunAudits.report`."""
        return self._audits.report(finished=finished)

    def _mark(self) -> None:
        """Let what was recorded so far stand."""
        self._audits.mark(self.t)
        marked = replace(self._state, law_state=None, mark=None)
        self._state = replace(self._state, mark=marked)

    def _go_back(self) -> MacroState:
        """The state at the mark, by the law's state as it is now, with its counts; what has been
        counted since is rolled back."""
        mark = self._state.mark
        spent = self._spent()
        assert mark is not None
        rolled_back = Counter(self._state.rolled_back)
        for now, then in ((spent["counts"], mark.counts), (spent["effort"], mark.effort)):
            rolled_back.update(now)
            rolled_back.subtract(then)
        self._state = replace(
            mark,
            law_state=self._equations.law_state,
            mark=mark,
            rolled_back=dict(+rolled_back),
            wall_time=self._seconds(),
        )
        return self._state

    @property
    def may_be_kept(self) -> bool:
        """Not in a step that the law is asked to commit: it may have taken down a part of it."""
        return not self._equations.is_committing

    def checkpoint(self) -> MacroState:
        """The state after the last step recorded, without what the next one has cost so far."""
        return replace(self._state, wall_time=self._seconds()).copy()

    def state(self) -> MacroState:
        """Everything up to the last step recorded, with all that was spent."""
        return replace(self._state, wall_time=self._seconds(), **self._spent())

    def _spent(self) -> dict[str, Any]:
        tally = self._equations.tally
        counts = {name: tally.counts[name] for name in COUNTS}
        return {"counts": counts, "effort": dict(tally.effort)}

    def _seconds(self) -> dict[str, float]:
        total = clock() - self._started
        law = self._equations.tally.law_seconds
        cpu = cpu_clock() - self._cpu_started
        return {"total": total, "law": law, "macro": total - law, "cpu": cpu}

    def _frames_due(self, t: float) -> int:
        return int(np.searchsorted(self._frame_fractions, t, side="right"))

    def _forces(self, now: Evaluation) -> Array:
        """(k, 2) forces on the tissue by supports, surface loads and bodies, µN."""
        return self._system.resultants(now.forces, self._equations.reaction(now))

    def _row(self, t: float, y: Array, work: Array, forces: Array) -> Array:
        """What `columns_of` lists; points beyond a bifurcation are those at the end of the step."""
        equations = self._equations
        motion = self._system.spread(y, t, equations.within)
        beyond = count_beyond(equations.law, equations.law_state)
        return row_of(self._system, t, motion, forces, beyond, work)
