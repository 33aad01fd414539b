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

# Extremes as of `widen_extremes`, before any point was met.
NO_EXTREMES = np.broadcast_to([[[[np.inf]]], [[[-np.inf]]]], (2, 4, 2, 2))

# The rows of `widen_extremes`: the entries 11, 12, 21, 22 of four tensors, one after another.
_F = 0
_F_DOT = 4
_U = 8
_RT_F_DOT = 12
_ROWS = 16


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
        """Make it from the lowest and highest entries that `widen_extremes` keeps."""
        return cls(*extremes.swapaxes(0, 1))

    def to_dict(self) -> dict[str, Any]:
        """Return the extremes, and `stretch`, `shear`, `rate` of the sampling range of them."""
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
    """Widen the lowest and highest entries of F, Ḟ, U = RᵀF and RᵀḞ by those of n points.

    R is the rotation of the polar decomposition, cos θ : sin θ = F₁₁ + F₂₂ : F₂₁ − F₁₂.

    Args:
        extremes: (2, 4, 2, 2) lowest and highest entries so far of these four tensors, in this
            order; changed in place.
        F, F_dot: (n, 2, 2).

    Eight points are taken at once, one in each lane. Where the last eight are not complete, the
    last point is repeated, which widens nothing.
    """
    values = np.empty((_ROWS, TILE))
    low = np.empty((_ROWS, TILE))
    high = np.empty((_ROWS, TILE))
    for row in range(_ROWS):
        tensor = row // 4
        i = row // 2 % 2
        j = row % 2
        low[row, :] = extremes[0, tensor, i, j]
        high[row, :] = extremes[1, tensor, i, j]
    for start in range(0, F.shape[0], TILE):
        for lane in range(TILE):
            p = np.uint64(min(start + lane, F.shape[0] - 1))
            for i in range(2):
                for j in range(2):
                    values[_F + 2 * i + j, lane] = F[p, i, j]
                    values[_F_DOT + 2 * i + j, lane] = F_dot[p, i, j]
        cosine = load(values, _F) + load(values, _F + 3)
        sine = load(values, _F + 2) - load(values, _F + 1)
        norm = root(cosine * cosine + sine * sine)
        cosine = cosine / norm
        sine = sine / norm
        for original, rotated in ((_F, _U), (_F_DOT, _RT_F_DOT)):
            for j in range(2):  # a column (x, y) of the tensor becomes Rᵀ (x, y)
                x = load(values, original + j)
                y = load(values, original + 2 + j)
                store(cosine * x + sine * y, values, rotated + j)
                store(cosine * y - sine * x, values, rotated + 2 + j)
        for row in range(_ROWS):
            value = load(values, row)
            lowest = load(low, row)
            highest = load(high, row)
            store(where_less(value, lowest, value, lowest), low, row)
            store(where_less(highest, value, value, highest), high, row)
    for row in range(_ROWS):
        tensor = row // 4
        i = row // 2 % 2
        j = row % 2
        extremes[0, tensor, i, j] = low[row].min()
        extremes[1, tensor, i, j] = high[row].max()


# An array of what a run or law does not have.
NOTHING: Array = np.empty(0)
# Values at the law's points, which are large, are kept at each frame whose number this divides, and
# at the last.
POINTS_EVERY = 10


@dataclass(frozen=True, slots=True)
class Frames:
    """Whole fields at k times.

    Each time is the end of the first step that passed an even fraction of the duration. There the
    stress is the one by which the run continued, and nothing is interpolated.

    Attributes:
        t: (k,) µs, increasing, from 0 to the end.
        displacement, velocity: (k, n_nodes, 2) µm and µm/µs.
        stress: (k, n_el, 2, 2) element mean of the Cauchy stress, µN/µm.
        F, F_dot: (k, n_el, 2, 2) element mean of the deformation gradient, and of its rate, 1/µs.
        source, risk: (k, n_el) as of `Sources`, the largest of the element's points; (k, 0) of a
            law that does not know them.
        beyond: (k, n_el) 1 where a point of the element is beyond a bifurcation, else 0; (k, 0) of
            a law that cannot tell.
        dissipated: (k, n_el) energy by reference area since t = 0, pJ/µm²; (k, 0) if not recorded.
            Between the samples of `MacroState` the rate counts as that of the last sample.
        point_t: (p,) µs, those of t at which the law's points are kept too: a tenth of them.
        point_stress: (p, n_points, 2, 2) Cauchy stress as the law answered, µN/µm.
        point_source, point_risk: (p, n_points) as of `Sources`; (p, 0) of a law without them.
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
        """Iterate over the frames, each alone, with its points where they are kept."""
        point = 0
        for k, t in enumerate(self.t):
            row = slice(k, k + 1)
            points = slice(point, point)
            # points are kept at some of the times; both are in the order of time
            if point < len(self.point_t) and self.point_t[point] == t:
                points = slice(point, point + 1)
                point += 1
            rows = {}
            for item in fields(self):
                kept = points if item.name.startswith("point_") else row
                rows[item.name] = getattr(self, item.name)[kept]
            yield Frames(**rows)

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
        """Make the frame of one state of a run.

        Args:
            space: the finite elements.
            now: motion and stress of the state.
            sources: where the stress came from, if the law knows it.
            dissipated: (n_el,) energy by reference area since t = 0, pJ/µm²; empty: not recorded.
            beyond: (n_points,) which points are beyond a bifurcation; None: not known.
            points: whether values at the law's points are kept, too.
        """
        n = len(space.nodes)
        stress = now.response.stress
        at_points = np.empty((2, 0))  # source and risk
        if sources is not None:
            at_points = np.stack([sources.source, sources.risk]).astype(np.float64)
        in_elements = at_points
        if at_points.size:
            in_elements = at_points.reshape(2, len(space.elements), -1).max(axis=2)
        kept = slice(0, int(points))  # of rows by time, of which there is one: that one or none
        return cls(
            t=np.array([now.t]),
            displacement=now.u[None, :n],
            velocity=now.v[None, :n],
            stress=element_mean_stress(space, now.F, stress)[None],
            F=element_mean_F(space, now.F)[None],
            F_dot=element_mean_F(space, now.F_dot)[None],
            source=in_elements[:1],
            risk=in_elements[1:],
            beyond=_in_elements(space, beyond)[None],
            dissipated=dissipated[None],
            point_t=np.array([now.t])[kept],
            point_stress=stress[None][kept],
            point_source=at_points[:1][kept],
            point_risk=at_points[1:][kept],
        )


def _in_elements(space: Discretisation, flags: Flags | None) -> Array:
    """Return (n_el,) 1 where a point of the element is flagged, else 0; (0,) of None."""
    if flags is None:
        return NOTHING
    in_element = flags.reshape(len(space.elements), -1).any(axis=1)
    return np.where(in_element, 1.0, 0.0)


# A function that takes whole fields at one time, with how many frames and how many frames of points
# there are before it. A frame whose number exists already replaces that one and all behind it.
KeepFrame = Callable[[Frames, int, int], None]

# What a run counts, by the names of `MacroRun.counts`.
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
        t: time at the end of the step, µs.
        y: (2 m,) displacement and velocity of the free unknowns.
        next_step: length proposed for the next step, µs.
        memory: what the integrator knows besides y; empty if and only if it is the explicit one.
        work: since t = 0, a row of `Works`, pJ.
        journal: ``rows`` (r, c) at the output times passed, the columns of `columns_of`;
            ``samples`` (s, 1 + k) t and rates of dissipation of `System.dissipating`, µs and pJ/µs,
            at ends of steps; ``frames.…`` as of `Frames`.
        dissipated: (2, n_el) energy up to the last sample, pJ, and its rate there, pJ/µs.
        extremes: (2, 4, 2, 2) lowest and highest entries of F, Ḟ, U and RᵀḞ.
        largest_displacement: of all nodes at ends of steps so far, µm.
        identity: digests of the problem's parts by name; a resumed run must have the same.
        counts, effort, rolled_back, wall_time: as in `MacroRun`.
        stress: (n_points, 2, 2) by which the next step begins, µN/µm.
        law_state: the state that the law has committed; None: it starts cold.
        rest: as `System.rest`; (0, 2) of None.
        drags: friction of the springs, µN/µm, by name of a body whose points stick.
        mark: the state to go back to if the steps after it do not stand; None: there is none. It
            is without the law's state, which the law itself keeps.
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
        """The whole fields that the journal has, at a few times."""
        return Frames(**self.journal.part("frames"))

    def copy(self) -> MacroState:
        """Return the same state with arrays of its own for what it has recorded."""
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
    """Return a row of a run's history: what `columns_of` lists, with the kinetic energy ½ v·M v.

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
    # positions of the nodes, by which outer sides that cross are counted
    x = system.discretisation.nodes + system.from_mesh(u)[: len(system.discretisation.nodes)]
    crossings = system.outer_sides.crossings(x)
    return np.concatenate([[t], *flat, depths, [beyond, crossings, stored, kinetic], work])


class Recorder:
    """Records a run in a `MacroState`, which is replaced as a whole after each accepted step.

    So no interrupt can tear what is recorded. `begin` or a state to resume from comes first; then
    `record` takes each step. For an audited law (`AuditedLaw`), `settle` says after each step
    whether to go back to the last mark.

    Args:
        equations: of the run.
        settings: of the macro scale: how many frames, and whether dissipation is recorded.
        resume: the state from which a run continues; None: it begins.
        begin: reading of `clock` when the run began, s; None: now.
        keep_frame: takes each frame instead of the state, which then has their times alone.
    """

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
        """Record the start of a run.

        `work` is a row of `Works`, pJ: that of the jump of prescribed velocities at the start.
        """
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
        recorded = self._at_end(state, journal, now, is_sample=True, is_frame=True)
        self._state = replace(state, **recorded, **self._spent())
        # a law without dissipation gave no sample at the start, so none follows
        self._record_dissipation &= len(self._state.journal["samples"]) > 0

    def record(self, step: StepResult, stepper: Stepper) -> None:
        """Record an accepted step, after which `stepper` stands at the step's end.

        Output times within the step get rows by interpolation. A frame and a sample of the
        dissipation are taken at its end, where one is due.
        """
        before = self._state
        end = step.end
        journal = before.journal
        begin = step.start.t
        passed = journal.lengths["rows"]
        due = int(np.searchsorted(self._t, end.t, side="right"))
        if end.t >= self.end:
            due = self._t.size  # rounding may put the last one beyond the duration
        if due > passed:
            forces_begin = self._forces(step.start)
            forces_end = self._forces(end)
            for t in self._t[passed:due]:
                within = min(t, end.t)
                fraction = (within - begin) / step.length
                forces = (1.0 - fraction) * forces_begin + fraction * forces_end
                work = before.work + step.work(within)
                row = self._row(t, step.interpolate(within), work, forces)
                journal = journal.written({"rows": row[None]})
        is_frame = self._frames_due(end.t) > self._frames_due(begin)
        # A sample of the dissipation costs another call of the law: so at about every other output
        # time, and at the last.
        is_sample = due // 2 > passed // 2 or passed < due == self._t.size
        work = before.work + step.work(end.t)
        recorded = self._at_end(before, journal, end, is_sample=is_sample, is_frame=is_frame)
        self._state = replace(before, **recorded, **self._end_of_step(stepper, work))

    def _end_of_step(self, stepper: Stepper, work: Array) -> dict[str, Any]:
        """Return the fields of a state that say where the run stands, and what it has spent."""
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

    def _at_end(
        self,
        state: MacroState,
        journal: Journal,
        now: Evaluation,
        *,
        is_sample: bool,
        is_frame: bool,
    ) -> dict[str, Any]:
        """Return the journal, dissipation and extremes of a state with those of the step's end.

        Args:
            state: the state before the step.
            journal: its journal, with the rows of the step.
            now: the end of the step.
            is_sample, is_frame: whether a sample of the dissipation, or a frame, is due.
        """
        energy, rates = state.dissipated
        if is_sample and self._record_dissipation:
            journal, energy, rates = self._sampled(journal, now, energy, rates)
        if is_frame:
            journal = self._with_frame(journal, now, energy, rates)
        extremes = state.extremes.copy()
        widen_extremes(extremes, now.F, now.F_dot)
        largest = float(np.sqrt((now.u**2).sum(axis=1).max()))
        return {
            "journal": journal,
            "dissipated": np.stack([energy, rates]),
            "extremes": extremes,
            "largest_displacement": max(state.largest_displacement, largest),
        }

    def _sampled(
        self, journal: Journal, now: Evaluation, energy: Array, last_rates: Array
    ) -> tuple[Journal, Array, Array]:
        """Take a sample of the dissipation.

        Args:
            energy: (n_el,) dissipated up to the last sample, pJ.
            last_rates: (n_el,) rates of dissipation there, pJ/µs.

        Returns:
            Journal, energy and rates with those of `now`, the energy by the trapezoidal rule; the
            same as before where the law does not know its dissipation.
        """
        rates: Array | None
        if now.v.any():
            rates = self._equations.dissipation_rates(now)
        else:
            rates = 0.0 * last_rates  # at rest nothing dissipates
        if rates is None:
            return journal, energy, last_rates
        samples = journal["samples"]
        since = now.t - samples[-1, 0] if len(samples) else 0.0
        energy = energy + 0.5 * since * (last_rates + rates)
        surface = self._system.surface
        of_regions = [rates[elements].sum() for elements in self._system.regions.values()]
        of_sides = () if surface is None else surface.dissipation_rates(now.u, now.v)
        row = [now.t, *of_regions, *of_sides]
        return journal.written({"samples": np.array([row])}), energy, rates

    def _with_frame(
        self, journal: Journal, now: Evaluation, energy: Array, rates: Array
    ) -> Journal:
        """Return the journal with the frame of `now`, or with its time where frames are given away.

        The energy since the last sample is extrapolated by the rates there.
        """
        density = NOTHING
        samples = journal["samples"]
        space = self._system.discretisation
        if len(samples):
            density = (energy + (now.t - samples[-1, 0]) * rates) / space.areas
        sources = None if now.response.sources is None else now.response.sources()
        with_points = (self._frames_due(now.t) - 1) % POINTS_EVERY == 0 or now.t >= self.end
        equations = self._equations
        beyond = beyond_bifurcation(equations.law, equations.law_state)
        frame = Frames.of(space, now, sources, density, beyond=beyond, points=with_points)
        if self._keep_frame is not None:
            frames_before = journal.lengths.get("frames.t", 0)
            points_before = journal.lengths.get("frames.point_t", 0)
            self._keep_frame(frame, frames_before, points_before)
        times_alone = self._keep_frame is not None
        return journal.written(frame_series(frame, times_alone=times_alone))

    @property
    def t(self) -> float:
        """Time of the last step recorded, µs."""
        return self._state.t

    def watch(self, resume: MacroState | None) -> None:
        """Begin to ask an audited law after every step whether the recorded steps stand.

        Where the run resumes within a window of steps that the law knows, that window continues;
        else a window begins here.
        """
        if self._audits.watch(has_mark=resume is not None and resume.mark is not None):
            self._mark()

    def settle(self, *, final: bool = False) -> MacroState | None:
        """Return the state to go back to where the steps since the mark do not stand, else None.

        With `final` no step follows, or none can, so the law must decide.
        """
        return self._audits.settle(self.t, self._mark, self._go_back, final=final)

    def close(self, closing: Callable[[int, int], None] | None) -> bool:
        """Solve a batch of the law's closing audit; see `RunAudits.close`."""
        return self._audits.close(closing)

    def report(self, *, finished: bool) -> Report:
        """Return the report of an audited law on this run; see `RunAudits.report`."""
        return self._audits.report(finished=finished)

    def _mark(self) -> None:
        """Let what was recorded so far stand, and go back to here if what follows does not."""
        self._audits.mark(self.t)
        marked = replace(self._state, law_state=None, mark=None)
        self._state = replace(self._state, mark=marked)

    def _go_back(self) -> MacroState:
        """Go back to the mark, and return the state there, with the law's state as it is now.

        What was counted since the mark moves to `rolled_back`.
        """
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
        """True if the state may be kept.

        It may not while the law commits a step, of which it may have recorded only a part.
        """
        return not self._equations.is_committing

    def checkpoint(self) -> MacroState:
        """Return the state after the last recorded step, without the cost of the next one."""
        return replace(self._state, wall_time=self._seconds()).copy()

    def state(self) -> MacroState:
        """Return everything up to the last step recorded, with all that was spent."""
        return replace(self._state, wall_time=self._seconds(), **self._spent())

    def _spent(self) -> dict[str, Any]:
        """Return counts and effort of the law so far, as fields of a state."""
        tally = self._equations.tally
        counts = {name: tally.counts[name] for name in COUNTS}
        return {"counts": counts, "effort": dict(tally.effort)}

    def _seconds(self) -> dict[str, float]:
        """Return the seconds of the run so far: all, of the law, of the rest, and of processors."""
        total = clock() - self._started
        law = self._equations.tally.law_seconds
        cpu = cpu_clock() - self._cpu_started
        return {"total": total, "law": law, "macro": total - law, "cpu": cpu}

    def _frames_due(self, t: float) -> int:
        """Return how many frames are due up to t."""
        return int(np.searchsorted(self._frame_fractions, t, side="right"))

    def _forces(self, now: Evaluation) -> Array:
        """Return (k, 2) forces on the tissue by supports, surface loads and bodies, µN."""
        return self._system.resultants(now.forces, self._equations.reaction(now))

    def _row(self, t: float, y: Array, work: Array, forces: Array) -> Array:
        """Return what `columns_of` lists; points beyond a bifurcation are those after the step."""
        equations = self._equations
        motion = self._system.spread(y, t, equations.within)
        beyond = count_beyond(equations.law, equations.law_state)
        return row_of(self._system, t, motion, forces, beyond, work)
