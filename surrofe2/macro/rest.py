"""Rest under constant loads: the load in steps, a predictor and Newton with line search at each.

A load step begins at the last equilibrium u₀. Where supports move by Δū, the first displacement is
that of the tangents there, K Δu = l(u₀) − f(u₀) − K̄ Δū with l by the new factor of the loads and
K̄ the columns of what supports move, so that the elements beside a support do not take all of Δū.
From there Newton's correction is halved until the residual falls and every point has a stress.
Points of contact with friction stick or slip throughout a correction and are sorted between them. A
load step that finds no equilibrium is halved.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import skfem

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.law.bifurcation import beyond_bifurcation
from surrofe2.law.stress_law import Status, StressLaw, require_tangents
from surrofe2.macro.audits import RunAudits
from surrofe2.macro.elements import (
    Matrix,
    displacement_basis,
    element_mean_F,
    element_mean_stress,
)
from surrofe2.macro.equations_of_motion import (
    EquationsOfMotion,
    Evaluation,
    NoStress,
    OutOfBalance,
    Switched,
    Tally,
    factorised,
)
from surrofe2.macro.forces import Contact, Slopes
from surrofe2.macro.free_sides import SurfaceForce
from surrofe2.macro.history import (
    NO_EXTREMES,
    Frames,
    KeepFrame,
    columns_of,
    row_of,
    widen_extremes,
)
from surrofe2.macro.settings import SECTION_6_2, MacroSettings
from surrofe2.macro.system import System, Works, system_of
from surrofe2.problem.conditions import DrivenCondition, PrescribedMotion
from surrofe2.problem.problem import Problem
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.run.journal import (
    BEYOND,
    FRAME_TIMES,
    Journal,
    RunState,
    check_frames,
    curves_of,
    frame_series,
    history_of,
    named_columns,
)
from surrofe2.run.loop import Progress, carry_out
from surrofe2.run.views import related

# A load step is halved so often, from its first length on, before the way ends.
MAX_HALVINGS = 10
# Newton's iterations in a load step; more where points of contact are also sorted into those that
# stick and those that slip.
MAX_ITERATIONS = 20
FRICTION_ITERATIONS = 60
# The first so many corrections sort all points of contact at once. Later ones sort those whose
# friction is off by at least this fraction of the largest error, since all may swing for ever.
_SORTED_TOGETHER = 10
_WORST = 0.5
# Smallest step in which surface tension grows to its whole.
_SMALLEST_SHARE = 1.0 / 16.0
# Line search: the smallest fraction of a correction, and the least decrease of the residual,
# relative to that of a linear one.
_LEAST_FRACTION = 1.0 / 64.0
_DECREASE = 1e-4
# A residual this small that no correction reduces is as small as rounding or the law allows.
_STALLED = 1e-6
# Without a load there is no force that a residual could be compared with. The scale is then the
# force that moves the stiffest unknown by so many absolute tolerances. At a Newton tolerance of
# 1e-8 the stiffest unknown is off by at most 1e-6 absolute tolerances, and the softest one, which
# may be 1e4 times as soft, by 1e-2. A smaller scale asks for more than an RVE's stress can give,
# since that is a difference of the pressure of the fluid and the tension of walls.
_UNLOADED = 100.0
# A rigid motion with less stiffness than this, relative to the largest, is not held.
_FREE = 1e-12
# What a law advises where an RVE does not converge; a rest has taken smaller steps already.
STEP_ADVICE = "; load in smaller steps or raise the iteration limit"
# Near a limit point the watched point moves so many times as fast with the load as at first.
_LIMIT_RATE = 3.0
# What a rest counts, by name.
_COUNTS = (
    "load_steps",
    "halvings",
    "repeated_steps",
    "factorisations",
    "stress_calls",
    "stress_points",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RestState(RunState):
    """An equilibrium on the way to a load: all that carries it on, and all it has recorded.

    Attributes:
        factor: factor of all loads and prescribed motions.
        u: (n, 2) displacement of nodes and bodies, µm; from `System.rest` where there is one.
        stress: (n_points, 2, 2) Cauchy stress, µN/µm.
        acts: (k + 2, n, 2) internal force, k other forces and reaction, µN.
        next_step: factor by which the next load step is larger.
        extremes: (2, 4, 2, 2) as in `MacroState`, of the equilibria on the way.
        drags: friction at all points of a body's contact, µN/µm, by name of the body.
        grip_u, grip_drags: displacement and friction of the equilibrium before, from which points
            of contact stick or slip to this one. The tangents depend on them.
        counts: load steps, halvings, factorisations by Newton's method; steps that were repeated
            because points left their branch of the law; stresses asked for.
        effort: sums of what the law's answers cost.
        rolled_back: the same counts and sums, over load steps that an audited law took back.
        law_seconds: time inside the stress law, s.
        journal: at each load step, from factor 0 on: ``rows`` (s, c), the columns of `columns_of`
            with the factor instead of the time; ``frames.…`` as of `Frames`, in the same way.
        rest: displacement that `System.rest` has, µm; (0, 2) where there is none.
        law_state: the state that the law has committed.
        mark: the state to go back to if the load steps after it do not stand; None: there is none.
            It is without the law's state, which the law itself keeps.
    """

    SERIES: ClassVar[tuple[str, ...]] = (
        "rows", *(f"frames.{item.name}" for item in fields(Frames))
    )  # fmt: skip

    factor: float
    u: Array
    stress: Array
    acts: Array
    next_step: float
    extremes: Array
    drags: dict[str, Array]
    grip_u: Array
    grip_drags: dict[str, Array]
    counts: dict[str, int]
    effort: dict[str, int]
    rolled_back: dict[str, int]
    law_seconds: float
    journal: Journal
    rest: Array
    law_state: Any = None
    mark: RestState | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Rest(RestState):
    """The tissue at rest under constant loads: an equilibrium with all that it is of.

    Attributes:
        system: mesh, mass and forces.
        F: (n_points, 2, 2) deformation gradient.
        stiffness, damping: (m, m) K and C of the free unknowns, see `EquationsOfMotion.tangents`.
        residuals: residual of each Newton iteration in the last load step, relative to the largest
            force.
        finished: whether the factor asked for was reached.
        cache: report of an audited law on this rest; None of other laws.
        decisions: decisions of an audited law on windows of load steps; None of other laws.
    """

    system: System
    F: Array
    stiffness: Matrix
    damping: Matrix
    residuals: tuple[float, ...]
    finished: bool = True
    cache: Mapping[str, Any] | None = None
    decisions: Sequence[Mapping[str, Any]] | None = None

    def __repr__(self) -> str:
        x, y = self.watched
        end = "finished" if self.finished else "unfinished"
        return (
            f"<Rest: {self.system.problem.mesh.nelements} elements, factor {self.factor:g} in "
            f"{self.counts['load_steps']} load steps, {end}; the watched point moved by "
            f"({x:.6g}, {y:.6g}) µm>"
        )

    @property
    def forces(self) -> Array:
        """Forces on the tissue at the end, (k, 2), in the order of `System.force_names`, µN."""
        columns = self.columns
        names = (f"force {name} {axis}" for name in self.system.force_names for axis in "xy")
        return np.array([columns[name][-1] for name in names]).reshape(-1, 2)

    def state(self, **changes: Any) -> RestState:
        """Return what carries this rest on, with changes of some entries."""
        kept = {item.name: getattr(self, item.name) for item in fields(RestState)}
        return RestState(**(kept | changes))

    @property
    def basis(self) -> skfem.Basis:
        """scikit-fem's basis of displacements, made at every access."""
        return displacement_basis(self.system.problem.mesh)

    @property
    def displacement(self) -> Array:
        """Displacement as a nodal vector of `basis`, (2 n_nodes,), µm."""
        return self.u[: len(self.system.discretisation.nodes)].ravel()

    @property
    def element_stress(self) -> Array:
        """Mean Cauchy stress of each element, (n_el, 2, 2), µN/µm; see `element_mean_stress`."""
        return element_mean_stress(self.system.discretisation, self.F, self.stress)

    @property
    def element_F(self) -> Array:
        """Mean deformation gradient of each element, (n_el, 2, 2); see `element_mean_F`."""
        return element_mean_F(self.system.discretisation, self.F)

    @property
    def path(self) -> Array:
        """Factor and displacement of the first watched point, µm, (steps + 1, 3)."""
        return self.journal["rows"][:, :3]

    @property
    def columns(self) -> dict[str, Array]:
        """Columns (steps + 1,) by name, those that `columns_of` lists; the factor has the name
        t.
        """
        return named_columns(columns_of(self.system, in_time=False), self.journal["rows"])

    @property
    def curves(self) -> dict[str, DisplacementCurve]:
        """Displacement of each watched point over the factor, by name."""
        return curves_of(self.path[:, 0], self.columns)

    @property
    def history(self) -> dict[str, Array]:
        """Columns (steps + 1,) over the factor, by name.

        They are mean displacements of boundaries (µm), forces of supports, loads and bodies on the
        tissue (µN), places and penetration of bodies (µm), and the number of points beyond a
        bifurcation, where the law knows it.
        """
        return history_of(self.columns)

    @property
    def watched(self) -> Array:
        """Displacement of the first watched point at the end, (2,), µm."""
        return self.path[-1, 1:]

    def relation(self, name: str, against: str) -> Array:
        """Return one column of `history` over another, (steps + 1, 2); see `ViewedRun.relation`.

        Examples:
            The force on a plate that shears a block, over its displacement:

            >>> from surrofe2 import Fixed, PrescribedMotion, Problem, RveLaw, find_rest, rectangle
            >>> plate = PrescribedMotion(name="plate", on="top", displacement=(50.0, 0.0))
            >>> block = Problem(
            ...     mesh=rectangle(2000.0, 1000.0, (4, 2)), conditions=(Fixed(on="bottom"), plate)
            ... )
            >>> rest = find_rest(block, RveLaw("apple"), load_steps=2)
            >>> _, *steps = rest.relation("force plate x", against="mean displacement top x")
            >>> for x, force in steps:  # after the unloaded block
            ...     print(f"{x:.0f} µm: {force:.0f} µN")
            25 µm: 205 µN
            50 µm: 413 µN
        """
        return related(self.history, name, against)

    @property
    def energies(self) -> dict[str, Array]:
        """Energies along the path, (steps + 1,) pJ by name.

        They are `internal` and the work of each force and of `motion`, by the trapezoidal rule
        (second order in the load step); `contact` and `contact dissipated`; and `balance`, the
        other works − internal, zero to Newton's tolerance.
        """
        system = self.system
        columns = self.columns
        stored = columns["contact"]
        internal = columns["work internal"]
        works = {force.name: columns[f"work {force.name}"] for force in system.forces}
        if system.moving:
            works["motion"] = columns["work motion"]
        energies = {"internal": internal, **works, "balance": sum(works.values()) - internal}
        if system.contacts:
            work_of_contacts = sum(works[contact.name] for contact in system.contacts)
            dissipated = stored[0] - stored - work_of_contacts
            energies |= {"contact": stored, "contact dissipated": dissipated}
        return energies


def find_rest(
    problem: Problem,
    law: StressLaw,
    settings: MacroSettings = SECTION_6_2,
    *,
    factor: float = 1.0,
    load_steps: int = 1,
    progress: Progress = None,
    checkpoint: Callable[[Rest], None] | None = None,
    checkpoint_interval: float = 30.0,
    resume: RestState | None = None,
    closing: Callable[[int, int], None] | None = None,
    keep_frame: KeepFrame | None = None,
) -> Rest:
    """Find the equilibrium of all forces at v = 0 and `factor` times the loads, from factor 0 on.

    Load steps of an audited law that do not stand are made again, as the steps of a run are.

    Friction depends on the way: a point of contact sticks where it touched until Coulomb's law lets
    it slip, from equilibrium to equilibrium, so more load steps follow its way more closely.

    Args:
        problem: as of `simulate`. Its amplitudes in time do not count.
        law: a law with tangents.
        factor: factor of all loads and prescribed motions; 0 is the tissue without load.
        load_steps: load steps to begin with.
        progress: called with the factor of each equilibrium on the way, and the last one; True: a
            line of the standard error shows it.
        checkpoint, checkpoint_interval: as of `simulate`; it is called with an equilibrium.
        resume: such an equilibrium, of the same problem on the way to the same factor; the result
            is that of the uninterrupted way, to the bit.
        closing, keep_frame: as of `simulate`; each load step is a frame.

    Raises:
        InputError: the law has no tangents, nothing holds a part of the tissue, a body begins
            inside it, or Newton's tolerance is below what rounding or the law allows.
        MismatchError: `resume` is of another mesh, or as of `simulate`.
        SimulationError: a load step halved ten times finds no equilibrium; `partial` is the last
            `Rest`.

    Examples:
        A block of apple flesh, 2 mm × 1 mm, is glued to two plates, of which the upper one moves by
        50 µm to the right. The force is that on a layer of 10 µm:

        >>> from surrofe2 import Fixed, PrescribedMotion, Problem, RveLaw, find_rest, rectangle
        >>> plate = PrescribedMotion(name="plate", on="top", displacement=(50.0, 0.0))
        >>> block = Problem(
        ...     mesh=rectangle(2000.0, 1000.0, (4, 2)), conditions=(Fixed(on="bottom"), plate)
        ... )
        >>> rest = find_rest(block, RveLaw("apple"))
        >>> print(f"{rest.history['force plate x'][-1]:.0f} µN")
        413 µN
    """
    require_tangents(law, "rest")
    if not np.isfinite(factor):
        raise InputError(f"factor: {factor}; it must be finite")
    if load_steps < 1:
        raise InputError(f"load_steps: {load_steps}; it must be at least 1")
    system = system_of(problem.proportional(), law)
    if resume is not None:
        if resume.u.shape != (system.n_rows, 2):
            raise MismatchError("resume: the mesh is not that of the state; start the rest again")
        check_frames(resume.journal, are_taken=keep_frame is not None)
    for contact in system.contacts:
        contact.check_start()
    equations = EquationsOfMotion(system, law, clock="load factor {:.6g}")
    if problem.surface is not None:
        begin_at_rest(equations, problem, settings, resume)
    if resume is None:
        audits = RunAudits(equations, None, 0.0)
    else:
        audits = RunAudits(equations, resume.law_state, resume.factor)
    way = Loading(Newton(equations, settings, keep_frame), audits, factor, factor / load_steps)
    return carry_out(
        way.steps(resume, closing),
        way,
        way.result,
        factor,
        progress=progress,
        checkpoint=checkpoint,
        interval=checkpoint_interval,
    )


def _spent(tally: Tally) -> dict[str, Any]:
    """Return what a rest has cost so far, as fields of `RestState`."""
    return {
        "counts": {name: tally.counts[name] for name in _COUNTS},
        "effort": dict(tally.effort),
        "law_seconds": tally.law_seconds,
    }


class ToleranceError(InputError):
    """Newton's method ends above its tolerance, where only rounding of the law's stress is left."""


@dataclass(slots=True)
class Loading:
    """The way from no load to a factor of it.

    Attributes:
        newton: finder of an equilibrium.
        audits: windows and verdicts of an audited law.
        factor: factor of the loads at which the way ends.
        longest: length of the first load step, and the longest of all.
        rest: the last equilibrium; None before there is one.
    """

    newton: Newton
    audits: RunAudits
    factor: float
    longest: float
    rest: Any = None

    @property
    def may_be_kept(self) -> bool:
        """True if the way may be kept: neither before an equilibrium nor while the law commits one.

        While it commits, the law may have recorded more than the way has.
        """
        return self.rest is not None and not self.newton.equations.is_committing

    def checkpoint(self) -> Rest:
        """Return the last equilibrium with arrays of its own for what was recorded."""
        rest: Rest = self.rest
        mark = rest.mark
        if mark is not None:
            mark = replace(mark, journal=mark.journal.copy())
        return replace(rest, journal=rest.journal.copy(), mark=mark)

    def result(self, finished: bool) -> Any:
        """Return the last equilibrium with the report of an audited law; None before there is
        one.
        """
        if self.rest is None:
            return None
        rest: Rest = self.rest
        report = self.audits.report(finished=finished)
        tally = self.newton.equations.tally
        return replace(
            rest,
            **_spent(tally),
            finished=finished,
            cache=report.cache,
            decisions=report.decisions,
        )

    def steps(
        self, resume: RestState | None, closing: Callable[[int, int], None] | None
    ) -> Iterator[float]:
        """Iterate over the equilibria: yield the factor of each, the one without load first.

        Then the batches of the closing audit of an audited law follow.

        Raises:
            SimulationError: there is none without load, or ten halvings of a load step find none.
        """
        newton = self.newton
        equations = self.newton.equations
        try:
            if resume is None:
                self.rest = newton.rest_at(0.0, None, self.longest)
            else:
                self.rest = newton.known(resume)
        except (NoStress, Switched) as reason:
            raise SimulationError(f"the load cannot start: {reason}") from reason
        equations.is_committing = False
        if resume is None:
            yield 0.0
        if self.rest.factor != self.factor:
            check_held(equations.system, self.rest.stiffness)
        if self.audits.watch(has_mark=self.rest.mark is not None):
            self._mark()
        # They are equal to the bit at the end, since the last target is the factor itself.
        while self.rest.factor != self.factor:
            failure = None
            try:
                self.rest = self._step(self.rest)
            except SimulationError as error:  # wrong answers of a surrogate may have led there
                failure = error
            is_last = failure is not None or self.rest.factor == self.factor
            back = self.audits.settle(
                self.rest.factor, self._mark, self._marked_state, final=is_last
            )
            if back is not None:
                self.rest = self._again(back)
            elif failure is not None:
                raise failure
            yield self.rest.factor
        while self.audits.close(closing):
            yield self.rest.factor

    def _mark(self) -> None:
        """Let the load steps so far stand, and go back to here if what follows does not."""
        rest: Rest = self.rest
        self.audits.mark(rest.factor)
        mark = rest.state(law_state=None, mark=None)
        self.rest = replace(rest, mark=mark)

    def _marked_state(self) -> RestState:
        """Return the state at the mark, with the law's state as it is now.

        What was spent since the mark counts as rolled back.
        """
        rest: Rest = self.rest
        mark = rest.mark
        assert mark is not None
        equations = self.newton.equations
        rolled_back = Counter(rest.rolled_back)
        spent = _spent(equations.tally)
        for now, then in ((spent["counts"], mark.counts), (spent["effort"], mark.effort)):
            rolled_back.update(now)
            rolled_back.subtract(then)
        return replace(
            mark,
            law_state=equations.law_state,
            law_seconds=equations.tally.law_seconds,
            mark=mark,
            rolled_back=dict(+rolled_back),
        )

    def _again(self, state: RestState) -> Rest:
        """Compute the equilibrium of a state to which the law went back."""
        try:
            return self.newton.known(state)
        except NoStress as failure:
            message = f"the load steps cannot be made again: {failure}"
            raise SimulationError(message) from failure

    def _step(self, rest: Rest) -> Rest:
        """Find the equilibrium after `rest`, by a load step that is halved until there is one.

        A step that succeeds at once is followed by one of twice its length, up to the first length.
        """
        step = rest.next_step
        longest = self.longest
        failed = False
        while True:
            remaining = self.factor - rest.factor
            # rounding must not leave a last step of nothing
            is_last = abs(step) >= abs(remaining) * (1.0 - 1e-9)
            target = self.factor if is_last else rest.factor + step
            following = min(step if failed else 2.0 * step, longest, key=abs)
            try:
                return self.newton.rest_at(target, rest, following)
            except (NoStress, ToleranceError) as failure:
                # The tolerance is refused in the first step. Later a shorter step may help, and
                # the path up to here is kept.
                is_first = len(rest.journal["rows"]) < 2
                if isinstance(failure, ToleranceError) and is_first:
                    raise
                self.newton.equations.tally.counts["halvings"] += 1
                step = 0.5 * (target - rest.factor)
                failed = True
                # Counted from the first length: near a limit load every second step would succeed.
                if abs(step) < abs(longest) * 0.5**MAX_HALVINGS:
                    raise SimulationError(self._why_stopped(failure)) from failure

    def _why_stopped(self, failure: NoStress | ToleranceError) -> str:
        """Say what ends the way: a limit load, a limit point, or how the last trial failed."""
        reason = str(failure).replace(STEP_ADVICE, ", in load steps however small")
        text = f"no load step succeeds after {MAX_HALVINGS} halvings: {reason}"
        text += self._who_failed(failure)
        rows = self.rest.journal["rows"]
        if len(rows) < 3 or not isinstance(failure, OutOfBalance):
            return text
        # a row begins with the factor and the displacement of the first watched point
        moved = np.linalg.norm(np.diff(rows[:, 1:3], axis=0), axis=1)
        rates = moved / abs(np.diff(rows[:, 0]))
        # At a limit point du/dfactor is infinite, as the inverse root of the distance to it.
        if not rates[-1] > _LIMIT_RATE * rates[0] > 0.0:
            return text
        if _is_pushed(self.newton.equations.system.problem):
            what = "limit load"
            remedy = "prescribe the motion instead of the force, or run in time"
        else:
            what = "limit point"
            remedy = "the tissue snaps to another one, so run in time"
        return (
            f"{what} at factor {self.rest.factor:.4g}: displacements grow without bound, and "
            f"beyond it there is no equilibrium nearby; {remedy}; {text}"
        )

    def _who_failed(self, failure: NoStress | ToleranceError) -> str:
        """Say whether plant cells have no equilibrium beyond here or a solver gave up, and what to
        do.

        The text begins with a semicolon, and is empty where neither is so.
        """
        place = f"load factor {self.rest.factor:.4g}"
        if isinstance(failure, OutOfBalance | ToleranceError):
            text = (
                f"; Newton's method for the tissue gave up beyond {place}, where the plant cells "
                "of every point have a stress"
            )
            beyond = self.rest.columns[BEYOND][-1]
            # where the law cannot tell it is NaN
            if not beyond > 0.0:
                return f"{text}: a run in time may carry on"
            return (
                f"{text}; {beyond:.0f} of {len(self.rest.F)} points have left a bifurcation, at "
                "which the stress of plant cells has a corner that Newton's method may not cross: "
                "a run in time may carry on, or another mesh"
            )
        if failure.status == Status.UNSTABLE:
            return (
                f"; plant cells have no stable equilibrium beyond {place}, and no solver gave up: "
                "use the path up to there, or lower the load"
            )
        if failure.status == Status.NOT_CONVERGED:
            return (
                f"; the solver of RVEs gave up beyond {place}: whether the plant cells have an "
                "equilibrium there is not known; use the path up to there"
            )
        return ""


def _is_pushed(problem: Problem) -> bool:
    """Return whether a force acts, and not prescribed motions alone."""
    for condition in problem.conditions:
        is_driven = isinstance(condition, DrivenCondition)
        if is_driven and not isinstance(condition, PrescribedMotion):
            return True
    # a body with a mass is not moved; loads act on it
    return any(body.mass is not None for body in problem.bodies)


def evaluation_at(equations: EquationsOfMotion, state: RestState) -> Evaluation:
    """Evaluate the equations, with tangents, at an equilibrium that was found before.

    Raises:
        NoStress: the law has no stress there any more.
    """
    free = equations.system.pick(state.u)
    y = np.concatenate([free, np.zeros(free.size)])
    equations.resume(state.factor, y, state.stress, state.law_state)
    while True:
        try:
            return equations.evaluate(state.factor, y, tangents=True)
        except Switched as switched:  # the law trusts its surrogate less than it did then
            equations.restart_step(switched.points)


def check_held(system: System, K: Matrix) -> None:
    """Refuse a load on a tissue or a rigid body that can move without any resistance.

    Such motions are combinations R of rigid motions that move nothing held and have Rᵀ K R = 0.

    Args:
        K: as of `EquationsOfMotion.tangents`, without load.

    Raises:
        InputError: naming the parts that are free.
    """
    nodes = system.discretisation.nodes
    x, y = (nodes - nodes.mean(axis=0)).T
    tissue = slice(0, len(nodes))
    rigid: list[tuple[str, slice, Any]] = [
        ("the tissue along x", tissue, (1.0, 0.0)),
        ("the tissue along y", tissue, (0.0, 1.0)),
        ("the tissue in rotation", tissue, np.stack([-y, x], axis=1)),
    ]
    for k, body in enumerate(system.problem.bodies, len(nodes)):
        rigid.append((f"{body.name} along x", slice(k, k + 1), (1.0, 0.0)))
        rigid.append((f"{body.name} along y", slice(k, k + 1), (0.0, 1.0)))
    motions = np.zeros((system.n_rows, 2, len(rigid)))
    for k, (_, rows, velocity) in enumerate(rigid):
        motions[rows, :, k] = velocity
    R = motions.reshape(-1, len(rigid))
    R /= np.linalg.norm(R, axis=0)
    held = np.delete(R, system.free, axis=0)
    stiffness = R[system.free].T @ (K @ R[system.free]) / abs(K.diagonal()).max()
    blocked = np.concatenate([held, *(contact.blocked(R) for contact in system.contacts)])
    values, vectors = np.linalg.eigh(blocked.T @ blocked + 0.5 * (stiffness + stiffness.T))
    moves = vectors[:, abs(values) < _FREE]
    if moves.size:
        parts = zip(rigid, abs(moves).max(axis=1), strict=True)
        # rigid motions that have a large part in one that is free
        loose = [name for (name, *_), part in parts if part > 0.1]
        raise InputError(
            f"conditions: nothing holds {', '.join(loose)} ({moves.shape[1]} free rigid motions); "
            "add fixed, symmetry, prescribed_motion or foundation, or bodies that touch from the "
            "start"
        )


def begin_at_rest(
    equations: EquationsOfMotion, problem: Problem, settings: MacroSettings, resume: Any = None
) -> None:
    """Let all displacements count from the rest under the surface tension of free sides.

    That rest is before anything moves the tissue: supports hold what they hold and bodies are away.
    Where Newton's method does not come to it at once, the tension grows in steps.

    Args:
        resume: a state with such a rest, which is then not computed again.

    Raises:
        InputError: the law has no tangents.
        SimulationError: there is no such rest.
    """
    if resume is not None:
        equations.system = equations.system.from_rest(resume.rest)
        return
    require_tangents(equations.law, "surface")
    system = system_of(replace(problem.proportional(), bodies=()), equations.law)
    alone = EquationsOfMotion(system, equations.law, clock="before the load")
    alone.tally = equations.tally
    newton = Newton(alone, settings)
    u = np.zeros((system.n_rows, 2))
    share = 0.0  # of the surface tension
    step = 1.0
    while share < 1.0:
        acting = partial(replace, share=share + step)
        alone.system = system.with_forces(SurfaceForce, acting)
        try:
            now, _, _ = newton.balanced(0.0, partial(system.pick, u))
            u = now.u
            share += step
        except NoStress as failure:
            step *= 0.5
            if step < _SMALLEST_SHARE:
                raise SimulationError(f"no rest under the surface tension: {failure}") from failure
    rest = np.pad(u, ((0, len(problem.bodies)), (0, 0)))
    equations.system = equations.system.from_rest(rest)
    equations.law_state = alone.law_state


@dataclass(slots=True)
class Newton:
    """Newton's method for the equilibrium of a system at a factor of its loads.

    Attributes:
        equations: the system, the law and what it has committed.
        settings: tolerances of the macro scale.
        keep_frame: takes the whole fields of each equilibrium, see `history.KeepFrame`.
    """

    equations: EquationsOfMotion
    settings: MacroSettings
    keep_frame: KeepFrame | None = None

    def rest_at(self, factor: float, last: Rest | None, next_step: float) -> Rest:
        """Find the equilibrium at `factor` after the last one, and let the law commit it.

        Args:
            last: the equilibrium before; None: there is none, and all begins without displacement.
            next_step: `RestState.next_step` of the result.

        Raises:
            NoStress: there is no such equilibrium.
        """
        equations = self.equations
        if last is None:
            grip_u = np.zeros((equations.system.n_rows, 2))
            # At rest points stick by all bodies, those with a slip speed included.
            contacts = equations.system.contacts
            grip_drags = {contact.name: np.zeros(contact.lengths.size) for contact in contacts}
            begin = partial(equations.system.pick, grip_u)
        else:
            grip_u = last.u
            grip_drags = last.drags
            begin = partial(self.predicted, factor, last)
        self._grip(grip_u, grip_drags)
        now, residuals, slopes = self.balanced(factor, begin)
        equations.tally.counts["load_steps"] += factor != 0.0
        system = equations.system
        reaction = equations.reaction(now)
        acts = np.stack([now.internal, *now.forces, reaction])
        if last is None:
            works = Works(0.0, np.zeros(len(now.forces))).row
            journal = Journal.of({})
            extremes = NO_EXTREMES.copy()
        else:
            # Mean force times displacement: of second order in the load step.
            internal, *forces, motion = np.einsum(
                "kni,ni->k", 0.5 * (last.acts + acts), now.u - last.u
            )
            step = Works(internal, np.array(forces), motion).row
            journal = last.journal
            extremes = last.extremes.copy()
            works = journal["rows"][-1, -step.size :] + step  # a row ends with its works
        widen_extremes(extremes, now.F, now.F_dot)
        beyond = beyond_bifurcation(equations.law, equations.law_state)
        count = float("nan") if beyond is None else float(beyond.sum())
        resultants = system.resultants(now.forces, reaction)
        row = row_of(system, factor, (now.u, now.v), resultants, count, works)
        sources = None if now.response.sources is None else now.response.sources()
        frame = Frames.of(equations.discretisation, now, sources, beyond=beyond)
        if self.keep_frame is not None:
            counts = [journal.lengths.get(name, 0) for name in FRAME_TIMES]
            self.keep_frame(frame, *counts)
        of_frame = frame_series(frame, times_alone=self.keep_frame is not None)
        rows = {"rows": row[None]}
        return Rest(
            factor=factor,
            u=now.u,
            stress=now.response.stress,
            acts=acts,
            next_step=next_step,
            extremes=extremes,
            drags={contact.name: contact.drag(now.u, now.v) for contact in system.contacts},
            grip_u=grip_u,
            grip_drags=grip_drags,
            **_spent(equations.tally),
            rolled_back={} if last is None else last.rolled_back,
            mark=None if last is None else last.mark,
            journal=journal.written(rows | of_frame),
            rest=np.empty((0, 2)) if system.rest is None else system.rest,
            law_state=equations.law_state,
            system=system,
            F=now.F,
            stiffness=slopes[0],
            damping=slopes[1],
            residuals=tuple(residuals),
        )

    def known(self, state: RestState) -> Rest:
        """Evaluate an equilibrium that was found before, and take over its counts.

        Raises:
            NoStress, Switched: as `EquationsOfMotion.evaluate`.
        """
        equations = self.equations
        self._grip(state.grip_u, state.grip_drags)
        now = evaluation_at(equations, state)
        K, C = equations.tangents(now)
        tally = equations.tally
        tally.counts = Counter(state.counts)
        tally.effort = Counter(state.effort)
        tally.law_seconds = state.law_seconds
        kept = {item.name: getattr(state, item.name) for item in fields(RestState)}
        kept |= {"journal": state.journal.copy(), "law_state": equations.law_state}
        return Rest(**kept, system=equations.system, F=now.F, stiffness=K, damping=C, residuals=())

    def balanced(
        self, factor: float, begin: Callable[[], Array]
    ) -> tuple[Evaluation, list[float], Slopes]:
        """Find an equilibrium at a factor of the loads.

        Newton begins with the free displacements (m,) that `begin` returns. It starts again where
        points leave their branch of the law, and continues from an equilibrium of the tissue in
        which the law moved a point to another equilibrium of its plant cells.

        Returns:
            The equilibrium, the relative residuals on the way to it, and K and C.

        Raises:
            NoStress: there is none.
        """
        u: Array | None = None
        residuals: list[float] = []
        while True:
            try:
                now, slopes = self._iterated(factor, begin() if u is None else u, residuals)
                start = self.equations.accept(now)
            except Switched as switched:
                points = self.equations.learn_ahead(factor, switched)
                residuals = []
                if points.any():
                    self.equations.restart_step(points)
                    u = None
                else:  # the law has learnt all that the trial needs, so go on from it
                    u = switched.y[: switched.y.size // 2]
                continue
            if start is now or start.response.left_bifurcation is None:
                return now, residuals, slopes
            u = now.y[: now.y.size // 2]

    def predicted(self, factor: float, last: Rest) -> Array:
        """Predict the free displacements (m,) after a load step.

        They are the last ones, or, where supports move, those that the tangents give.

        Raises:
            NoStress: the stiffness is singular, or as `EquationsOfMotion.evaluate`.
        """
        equations = self.equations
        system = self.equations.system
        u = system.pick(last.u)
        target, _ = system.spread(self._still(u), factor, equations.within)
        moved = target - last.u
        # A body that does not touch yet has no part in the tangents.
        if not moved[: len(system.discretisation.nodes)].any():
            return u
        now = equations.evaluate(last.factor, self._still(u), tangents=True)
        loads = sum(force.at(factor, now.within, now.u, now.v) for force in system.forces)
        residual = system.pick(loads - now.internal) - equations.stiffness_times(now, moved)
        return u + self._solved(now, equations.slope(now, 1.0, 0.0), residual)

    def corrected(self, now: Evaluation, K: Matrix) -> Evaluation:
        """Make Newton's correction by K, halved until the residual falls and every point has a
        stress.

        Raises:
            NoStress: no fraction of the correction does.
            Switched: points left their branch of the law.
        """
        size = np.linalg.norm(now.residual)
        correction = self._still(self._solved(now, K, now.residual))
        fraction = 1.0
        failure = None
        while fraction >= _LEAST_FRACTION:
            try:
                trial = self.equations.evaluate(now.t, now.y + fraction * correction, tangents=True)
            except NoStress as of_trial:
                failure = of_trial
            else:
                if np.linalg.norm(trial.residual) <= (1.0 - _DECREASE * fraction) * size:
                    return trial
            fraction *= 0.5
        # A point without stress stops the search; its own failure says more than the residual.
        if failure is not None and self.relative_residual(now, K) > _STALLED:
            raise failure
        raise self._stopped(now, K, "the line search found no smaller residual")

    def relative_residual(self, now: Evaluation, K: Matrix) -> float:
        """Return the largest residual relative to the largest force.

        The forces are the internal one, the others now and at factor 1, and that of `_UNLOADED`,
        which counts where there is no load.
        """
        full = [force.at(1.0, now.within, now.u, now.v) for force in self.equations.system.forces]
        forces = (now.internal, now.forces, *full)
        least = _UNLOADED * float(abs(K.diagonal()).max()) * self.settings.absolute_tolerance
        scale = max(least, *(abs(force).max(initial=0.0) for force in forces))
        return float(abs(now.residual).max() / scale)

    def _iterated(
        self, factor: float, u: Array, residuals: list[float]
    ) -> tuple[Evaluation, Slopes]:
        """Iterate Newton's method from u to its tolerance.

        Each iteration appends its relative residual to `residuals`.

        Returns:
            The equilibrium, and K and C there.

        Raises:
            NoStress, Switched: as `corrected`.
        """
        equations = self.equations
        now = equations.evaluate(factor, self._still(u), tangents=True)
        held = equations.system
        rubs = any(contact.friction for contact in held.contacts)
        most = FRICTION_ITERATIONS if rubs else MAX_ITERATIONS
        while True:
            K = equations.slope(now, 1.0, 0.0)
            residuals.append(self.relative_residual(now, K))
            if residuals[-1] <= self.settings.newton_tolerance:
                return now, (K, equations.slope(now, 0.0, 1.0))
            if len(residuals) > most:
                reason = f"Newton did not converge in {most} iterations"
                raise self._stopped(now, K, reason)
            if rubs:
                part = 0.0 if len(residuals) <= _SORTED_TOGETHER else _WORST
                held = held.with_forces(Contact, partial(Contact.held, u=now.u, part=part))
                now = self._corrected_by(held, now)
            else:
                now = self.corrected(now, K)

    def _corrected_by(self, held: System, now: Evaluation) -> Evaluation:
        """Make Newton's correction with points of contact that `held` keeps sticking or slipping.

        Coulomb's law has a corner where a point begins to slip, behind which a correction need not
        be of any use. Held, forces are smooth. Raises as `corrected`.
        """
        equations = self.equations
        free = equations.system
        equations.system = held
        try:
            now = equations.with_forces_of_now(now)
            now = self.corrected(now, equations.slope(now, 1.0, 0.0))
        finally:
            equations.system = free
        return equations.with_forces_of_now(now)

    def _solved(self, now: Evaluation, K: Matrix, residual: Array) -> Array:
        """Solve K x = residual (m,); raises `NoStress` where K is singular."""
        self.equations.tally.counts["factorisations"] += 1
        solve = factorised(K)
        if solve is None:
            raise self.equations.out_of_balance(now, residual, "the stiffness is singular")
        return solve(residual)

    def _stopped(self, now: Evaluation, K: Matrix, reason: str) -> NoStress:
        """Return the failure of Newton's method, or refuse its tolerance.

        Raises:
            ToleranceError: the residual is as small as it can be, and above the tolerance.
        """
        tolerance = self.settings.newton_tolerance
        smallest = self.relative_residual(now, K)
        if smallest > _STALLED:
            return self.equations.out_of_balance(now, now.residual, reason)
        raise ToleranceError(
            f"macro.newton_tolerance: {tolerance:.3g}; at {self.equations.clock.format(now.t)} the "
            f"residual stays at {smallest:.1e} of the largest force, the rounding of the stress "
            f"law's answers; ask for at least {10.0 * smallest:.0e}"
        )

    def _still(self, u: Array) -> Array:
        """Return y (2 m,) of free displacements (m,) without velocity."""
        return np.concatenate([u, np.zeros(u.size)])

    def _grip(self, u: Array, drags: Mapping[str, Array]) -> None:
        """Let contacts stick or slip from an equilibrium on; u and drags as of `Rest`."""
        self.equations.system = self.equations.system.gripped(u, drags)
