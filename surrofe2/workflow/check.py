"""Checks of a recipe before it is run: its faults, the range it meets, its cost, and a law for it.

The dry run takes the quadratic law, the exact tangents of the recipe's RVE at rest. It knows
neither stiffening nor loss of stability, but its time steps are those of a run by RVEs within a few
per cent. Its times are orders of magnitude: the number of solves times the time of one.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.clock import clock, cpu_clock
from surrofe2.base.errors import FileError, InputError, MismatchError, SimulationError
from surrofe2.base.sampling import SamplingRange
from surrofe2.law.stress_law import StressLaw, StressResponse
from surrofe2.macro import MetRange, find_rest, simulate
from surrofe2.macro.forces import check_bodies
from surrofe2.macro.history import NO_EXTREMES, widen_extremes
from surrofe2.macro.settings import RestSettings
from surrofe2.macro.system import check_conditions
from surrofe2.plant_cell.measurements import DETERMINED, measurements_of
from surrofe2.plant_cell.parameters import CellParameters, LivingTissue
from surrofe2.problem import Problem
from surrofe2.problem.mesh import area_of, element_nodes, extent, facet_nodes, length_of
from surrofe2.problem.problem import label
from surrofe2.recipe.recipe import CellName, CellStudy, Recipe, load_recipe
from surrofe2.run.loop import Report, no_report
from surrofe2.store.surrogates import check_surrogate, read_surrogate
from surrofe2.surrogate.deformation_paths import WatchedLaw
from surrofe2.workflow import laws
from surrofe2.workflow.generate import check_data
from surrofe2.workflow.laws import law_by_region
from surrofe2.workflow.time_scales import TimeScales, time_scales
from surrofe2.workflow.train import is_trained

# Proposed ranges.
# They hold this fraction more strain and rate than the dry run met, which knows no stiffening.
MARGIN = 0.2
# Least rate of a proposed range, 1/µs: that of a rest, whose stress does not depend on the rate.
LEAST_RATE = 1e-4

# The time of a check, and the meshes that it takes.
# Seconds of processor time of all dry runs; those on the recipe's mesh have half of it.
SECONDS = 10.0
# Elements of a mesh that is checked, so that memory stays below 1 GB; a rectangle of more is
# coarsened.
MOST_ELEMENTS = 65_536
# A mesh of so few elements along its longer side is not coarsened: it would show no bending.
_COARSEST = 4
# Elements of a mesh on which the time scales are known well enough.
_FEW_ELEMENTS = 1024
# Fraction of the load of a dry rest from which on its whole cost is extrapolated.
_LEAST_REACHED = 0.01
# Frames of a dry run, at which its largest displacement is measured.
_FRAMES = 21

# RVEs are timed along the last steps of a dry run: so many steps, so many points of each, and none
# begun after so much processor time.
_TIMED_STEPS = 24
_TIMED_POINTS = 128
_TIMED_SECONDS = 3.0

# Boundaries, or regions, of a mesh that a check lists.
_MOST_PARTS = 30
# About the least time in which a data set and a surrogate are made, s.
_SECONDS_TO_LEARN = 30.0


def recipe_faults(path: Path) -> list[str]:
    """Return an error message for each faulty entry of a recipe; none where it can be read."""
    try:
        load_recipe(path)
    except (FileError, InputError) as error:
        return [f"{path.name}: {fault}" for fault in error.faults] or [str(error)]
    return []


def study_faults(recipe: Recipe, kinds: Sequence[str], *, fresh: bool = False) -> list[str]:
    """List what keeps runs of a recipe by these laws from their end: mesh, names, range, files.

    Args:
        kinds: laws as of `--law`, e.g. ``("rve", "cached")``.
        fresh: a data set and a surrogate that exist do not count, since they are made again.

    Returns:
        An error message for each fault; none where the runs can be made.
    """
    checks: list[Callable[[], Any]] = [partial(_check_problem, recipe)]
    if "table" in kinds:
        checks.append(partial(laws.check_solver, recipe))
    for study in recipe.studies().values():
        if kinds != ("rve",):
            checks.append(study.sampling_range)
        if "cached" in kinds:
            checks += [study.data_path, study.training_path]
            if not fresh:
                checks.append(partial(_check_files, study))
    faults = []
    for check in checks:
        try:
            check()
        except (FileError, InputError, MismatchError) as error:
            faults.append(str(error))
    return faults


def _check_problem(recipe: Recipe) -> None:
    """Check mesh and names, supports and loads, and that bodies begin outside the tissue."""
    problem = recipe.problem()
    with recipe.named(InputError):
        check_conditions(problem)
        check_bodies(problem)


def parts_of_mesh(recipe: Recipe) -> list[str]:
    """Describe the recipe's mesh in lines of text.

    The first line is about the mesh. One line for each boundary and region says how many sides,
    elements and nodes it has, and how long or large it is. One line for each node on which
    conditions act alone follows.

    Raises:
        FileError, InputError: as of `Recipe.problem`.
    """
    problem = recipe.problem()
    mesh = problem.mesh
    low, high = extent(mesh)
    nodes = element_nodes(mesh)
    kind = "quadrilateral" if nodes.shape[1] == 4 else "six-node triangle"
    area = area_of(mesh, np.arange(mesh.nelements))
    lines = [
        f"mesh: {_counted(mesh.nelements, kind)}, {mesh.p.shape[1]:,} nodes, "
        f"x from {low[0]:.6g} to {high[0]:.6g} µm, y from {low[1]:.6g} to {high[1]:.6g} µm, "
        f"{area:,.6g} µm²"
    ]
    boundaries = mesh.boundaries or {}
    regions = mesh.subdomains or {}
    for name, facets in list(boundaries.items())[:_MOST_PARTS]:
        # a side within the tissue has elements on both sides of it
        inner = np.count_nonzero(mesh.f2t[1, facets] != -1)
        within = f", {inner:,} of them within the tissue" if inner else ""
        nodes_on_it = _counted(len(np.unique(facet_nodes(mesh, facets))), "node")
        sides = _counted(len(facets), "side")
        length = length_of(mesh, facets)
        lines.append(f"boundary {name}: {sides}{within}, {nodes_on_it}, {length:,.6g} µm")
    for name, elements in list(regions.items())[:_MOST_PARTS]:
        nodes_in_it = _counted(len(np.unique(nodes[elements])), "node")
        inside = _counted(len(elements), "element")
        lines.append(f"region {name}: {inside}, {nodes_in_it}, {area_of(mesh, elements):,.6g} µm²")
    for what, names in (("boundaries", boundaries), ("regions", regions)):
        if len(names) > _MOST_PARTS:
            lines.append(f"and {len(names) - _MOST_PARTS} more {what}")
    for place in problem.acted_nodes():
        x, y = mesh.p[:, place.node(mesh, "on")]
        acting = [label(condition) for condition in problem.conditions if condition.on == place]
        lines.append(f"node at ({x:.6g}, {y:.6g}) µm: {', '.join(acting)}")
    return lines


def lines_of_cells(recipe: Recipe) -> list[str]:
    """Describe each plant cell of a recipe in two lines.

    The first has what experiments would measure of it, the second the constants that mean the same.
    """
    lines = []
    for name, entry in recipe.cells.items():
        cell = entry.parameters
        values = measurements_of(cell)
        units = {item.name: item.metadata["unit"] for item in fields(LivingTissue)}
        measured = [f"{key} {value:.4g} {units[key]}" for key, value in values.items()]
        if "turgor" not in values:
            measured.append("turgor by `surrofe2 moduli`")
        units = {item.name: item.metadata["unit"] for item in fields(CellParameters)}
        # no constant twice, though wall_stiffness follows from two measurements
        names = dict.fromkeys(key for keys in DETERMINED.values() for key in keys)
        constants = [f"{key} {getattr(cell, key):.4g} {units[key]}" for key in names]
        lines += [
            f"{'plant cell' if name is None else f'cell {name}'}: {', '.join(measured)}",
            f"  as constants: {', '.join(constants)}",
        ]
    return lines


def _counted(number: int, what: str) -> str:
    """Write a number of things in words: "1 side", "2,000 sides"."""
    return f"{number:,} {what}" if number == 1 else f"{number:,} {what}s"


def _check_files(study: CellStudy) -> None:
    """Check that data set and surrogate, as far as they exist and are whole, are of this recipe.

    Raises:
        FileError, MismatchError: they are not whole, or of another cell, range or version.
    """
    cell = study.cell
    if cell.range is None or cell.samples.file is None or cell.training_file is None:
        return  # another check reports it
    data = study.data_path()
    if data.exists():
        check_data(study, data)
    trained = study.training_path()
    if trained.exists():
        surrogate = read_surrogate(trained)
        check_surrogate(trained, surrogate, cell.parameters, study.recipe.rve.initialisation)


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRun:
    """Cost and range of a run, as a dry run by the quadratic law found them.

    A run calls its law for all quadrature points at once. Dicts are by name of the plant cell.

    Attributes:
        points: number of quadrature points.
        calls: how often the run calls its law, extrapolated where the dry run was cut short.
        reached: fraction of the duration, or of the load, that the dry run came to; `met` holds up
            to there.
        met: strains and rates that the points of a cell met.
        steps: the last accepted (F, Ḟ), (n, 2, 2) each, of some of a cell's points.
        shares: fraction of the points that are of this cell.
        with_tangents: whether each call asks for tangents too, as those of a rest do.
        displacement: the largest, µm; 0 where the run did not come to its end.
        omitted: what the time or the size of the mesh did not allow; empty where nothing was.
    """

    points: int
    calls: float
    reached: float
    met: dict[CellName, MetRange]
    steps: dict[CellName, list[tuple[Array, Array]]]
    shares: dict[CellName, float]
    with_tangents: bool = False
    displacement: float = 0.0
    omitted: str = ""

    @property
    def solves(self) -> float:
        """Number of RVEs that a run by RVEs solves."""
        return self.calls * self.points


class _CutShort(Exception):  # noqa: N818 - no error
    """Ends a dry run whose time is over; what was recorded so far counts."""


class _Recorder(WatchedLaw):
    """The quadratic law of a cell, which records how often it is called and with what.

    Attributes:
        extremes: lowest and highest strains and rates, as of `widen_extremes`.
        steps: (F, Ḟ) of the last accepted steps, at some of the points.
        calls: how often `respond` was called.
        points: how many points the last call had.
    """

    def __init__(self, law: StressLaw) -> None:
        super().__init__(law, self._note)
        self.extremes = NO_EXTREMES.copy()
        self.steps: deque[tuple[Array, Array]] = deque(maxlen=_TIMED_STEPS)
        self.calls = 0
        self.points = 0

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """Compute the stress, and count the call."""
        self.calls = self.calls + 1
        self.points = len(F)
        return super().respond(F, F_dot, state, tangents=tangents)

    def _note(self, F: Array, F_dot: Array) -> None:
        """Record an accepted step: its extremes, and some points evenly from all."""
        widen_extremes(self.extremes, F, F_dot)
        stride = math.ceil(len(F) / _TIMED_POINTS)
        some = slice(None, None, stride)
        self.steps.append((F[some].copy(), F_dot[some].copy()))


def dry_run(recipe: Recipe, seconds: float = SECONDS, report: Report = no_report) -> DryRun:
    """Make a dry run of a recipe's problem, in so many seconds of processor time.

    Half of the time is for the recipe's own mesh, which gives the number of calls, extrapolated
    where the run is cut short. Range and steps must be of a whole run. So a rectangle that did not
    come to its end is run again in the rest of the time, with half, a quarter, … of the elements
    each way.

    Raises:
        InputError: the mesh is too large, and no rectangle that can be coarsened.
        SimulationError: the run could not be carried on.
    """
    end = cpu_clock() + seconds
    mesh, halvings = checked_mesh(recipe)
    first = best = _dry_run(mesh, 0.5 * seconds, report)
    while best.reached < 1.0 and (remaining := end - cpu_clock()) > 0.0:
        # half as many elements each way take a sixteenth of the time: a quarter of the points, and
        # steps that viscosity limits by the square of an element's size
        needed = 0.5 * seconds / max(best.reached, 1e-6)
        coarser = _coarser(mesh, max(1, math.ceil(math.log(2.0 * needed / remaining, 16.0))))
        if coarser is None:
            break
        mesh = coarser
        best = _dry_run(coarser, remaining, report)
    # where `checked_mesh` has halved the elements each way, the recipe's own mesh has four times
    # the points, and steps a quarter as long, since viscosity limits them
    run = replace(best, points=first.points * 4**halvings, calls=first.calls * 4.0**halvings)
    if best.reached >= 1.0:
        return run
    until = f"what is met after {best.reached * recipe.duration:.3g} of {recipe.duration:g} µs"
    return replace(run, omitted=until)


def checked_mesh(recipe: Recipe) -> tuple[Recipe, int]:
    """Return the recipe on a mesh that can be checked, and how often elements were merged each way.

    Raises:
        InputError: the mesh is too large, and cannot be coarsened.
    """
    elements = recipe.mesh.elements or (1, 1)
    halvings = 0
    while math.prod(elements) > MOST_ELEMENTS * 4**halvings:
        halvings += 1
    mesh = _coarser(recipe, halvings) if halvings else recipe
    if mesh is None:
        raise InputError(
            f"{recipe.path.name}: mesh.elements: {elements[0]} × {elements[1]}; at most "
            f"{MOST_ELEMENTS:,} can be checked, and this mesh cannot be coarsened; check fewer"
        )
    return mesh, halvings


def _coarser(recipe: Recipe, halvings: int) -> Recipe | None:
    """Halve the elements each way, as often as asked, or less often where names do not allow it.

    Returns:
        The recipe on the coarser mesh; None where its mesh is no rectangle, has regions, or is as
        coarse as it may be.
    """
    elements = recipe.mesh.elements
    if elements is None or len(recipe.cells) > 1:
        return None
    for times in range(halvings, 0, -1):
        fewer = (max(1, elements[0] // 2**times), max(1, elements[1] // 2**times))
        if fewer == elements or max(elements) // 2 ** (times - 1) <= _COARSEST:
            continue
        coarser = replace(recipe, mesh=replace(recipe.mesh, elements=fewer))
        with suppress(InputError):  # it may name a part of the boundary that a coarse mesh lacks
            coarser.problem()
            return coarser
    return None


def _dry_run(recipe: Recipe, seconds: float, report: Report) -> DryRun:
    """Run a recipe by the quadratic law, at most for so long, and extrapolate its calls."""
    problem = recipe.problem()
    law, recorders = _recorded_law(recipe, problem)
    end = cpu_clock() + seconds
    marks = [(0.0, 0)]  # at the end of each step: t, and how often the law was called
    displacement = 0.0

    def progress(t: float, duration: float) -> None:
        """Note the calls so far, and end the run where its time is over."""
        report(t, "")
        marks.append((t, max(recorder.calls for recorder in recorders.values())))
        if cpu_clock() > end:
            raise _CutShort

    try:
        with suppress(_CutShort), recipe.named(InputError):
            run = simulate(problem, law, replace(recipe.macro, frames=_FRAMES), progress=progress)
            displacement = run.largest_displacement
    except SimulationError as error:
        raise SimulationError(f"check: the dry run by the quadratic law: {error}") from error
    # The first steps are shorter than most, so the second half of what was run says at which rate
    # the run continues.
    t, calls = marks[-1]
    t_half, calls_half = marks[(len(marks) - 1) // 2]
    remaining = (recipe.duration - t) / (t - t_half) if t > t_half else 0.0
    return _tried(
        recorders,
        calls=calls + remaining * (calls - calls_half),
        reached=t / recipe.duration,
        displacement=displacement,
    )


def _recorded_law(recipe: Recipe, problem: Problem) -> tuple[StressLaw, dict[CellName, _Recorder]]:
    """Make the quadratic law of a tissue, and the recorders in it by name of their cell."""
    recorders: dict[CellName, _Recorder] = {}

    def recorded(study: CellStudy) -> StressLaw:
        """Make the recorded law of one cell, and keep its recorder."""
        recorder = _Recorder(laws.quadratic_law(study))
        recorders[study.name] = recorder
        return recorder

    return law_by_region(recipe, problem.mesh, recorded), recorders


def _tried(recorders: Mapping[CellName, _Recorder], **entries: Any) -> DryRun:
    """Make the result of a dry run from its recorders; `entries` are its other fields."""
    points = sum(recorder.points for recorder in recorders.values())
    return DryRun(
        points=points,
        met={name: MetRange.of(recorder.extremes) for name, recorder in recorders.items()},
        steps={name: list(recorder.steps) for name, recorder in recorders.items()},
        shares={name: recorder.points / points for name, recorder in recorders.items()},
        **entries,
    )


def scales_of(recipe: Recipe) -> TimeScales:
    """Compute the time scales of a recipe, by the tangents of its RVEs at rest.

    They are global properties of the tissue, so its mesh is coarsened where it can be.
    """
    mesh, _ = checked_mesh(recipe)
    elements = math.prod(mesh.mesh.elements or (1, 1))
    halvings = math.ceil(0.5 * math.log2(max(1.0, elements / _FEW_ELEMENTS)))
    coarse = (_coarser(mesh, halvings) if halvings else None) or mesh
    problem = coarse.problem()
    law = law_by_region(coarse, problem.mesh, laws.quadratic_law)
    with recipe.named(InputError):
        return time_scales(coarse, problem, law)


def dry_rest(recipe: Recipe, seconds: float = SECONDS, report: Report = no_report) -> DryRun:
    """Compute a rest of a recipe's problem by the quadratic law, in so many seconds.

    The seconds are of processor time. Where half of them do not suffice, the rest is computed on a
    coarser mesh, as by `dry_run`.

    Raises:
        InputError: the mesh is too large, and no rectangle that can be coarsened.
        SimulationError: a load step finds no equilibrium.
    """
    end = cpu_clock() + seconds
    mesh, halvings = checked_mesh(recipe)
    first = best = _dry_rest(mesh, 0.5 * seconds, report)
    while best.reached < 1.0 and (remaining := end - cpu_clock()) > 0.0:
        # half as many elements each way are solved in an eighth of the time
        needed = 0.5 * seconds / max(best.reached, _LEAST_REACHED)
        coarser = _coarser(mesh, max(1, math.ceil(math.log(2.0 * needed / remaining, 8.0))))
        if coarser is None:
            break
        mesh = coarser
        best = _dry_rest(coarser, remaining, report)
    # load steps, and so calls, are as many on any mesh
    rest = replace(best, points=first.points * 4**halvings)
    if best.reached >= 1.0:
        return rest
    until = f"what is met after {100.0 * best.reached:.3g} % of the load"
    return replace(rest, omitted=until)


def _dry_rest(recipe: Recipe, seconds: float, report: Report) -> DryRun:
    """Compute a rest by the quadratic law, at most for so long, and extrapolate its calls."""
    problem = recipe.problem()
    law, recorders = _recorded_law(recipe, problem)
    settings = recipe.rest or RestSettings()
    end = cpu_clock() + seconds
    reached = 0.0
    displacement = 0.0

    def progress(factor: float, last_factor: float) -> None:
        """Note how far the load has come, and end the rest where its time is over."""
        nonlocal reached
        # without a load the only step is the last one
        reached = factor / last_factor if last_factor else 1.0
        report(reached, "")
        if reached < 1.0 and cpu_clock() > end:
            raise _CutShort

    try:
        with suppress(_CutShort), recipe.named(InputError):
            rest = find_rest(
                problem,
                law,
                recipe.macro,
                **asdict(settings),
                progress=progress,
            )
            displacement = float(np.linalg.norm(rest.u, axis=1).max())
    except SimulationError as error:
        raise SimulationError(f"check: the dry rest by the quadratic law: {error}") from error
    calls = max(recorder.calls for recorder in recorders.values())
    return _tried(
        recorders,
        calls=calls / max(reached, _LEAST_REACHED),
        reached=reached,
        with_tangents=True,
        displacement=displacement,
    )


def seconds_by_rves(recipe: Recipe, run: DryRun) -> float:
    """Estimate the order of magnitude of a run by RVEs, s: its solves times a timed one."""
    per_solve = 0.0  # mean over the cells, by their share of the points
    for name, share in run.shares.items():
        law = laws.true_law(CellStudy(recipe, name))
        per_solve += share * _seconds_per_solve(law, run.steps[name], run.with_tangents)
    return run.solves * per_solve


def _seconds_per_solve(law: StressLaw, steps: list[tuple[Array, Array]], tangents: bool) -> float:
    """Measure the seconds of one RVE along recorded steps, each solved from the state before it.

    Returns:
        The median of the second half of the steps; the first ones start cold, or extrapolate from
        too few steps. 0 where no step was recorded.
    """
    state = None
    times: list[float] = []
    end = cpu_clock() + _TIMED_SECONDS
    for F, F_dot in steps:
        started = clock()
        answer = law.respond(F, F_dot, state, tangents=tangents)
        times.append((clock() - started) / len(F))
        # a time loop repeats a step whose RVEs switch state; here they stay in the new one
        state = law.accept(F, F_dot, replace(answer, switched=None)).state
        if cpu_clock() > end:
            break
    if not times:
        return 0.0
    return float(np.median(times[len(times) // 2 :]))


def advised_law(recipe: Recipe, seconds: float, *, at_rest: bool = False) -> str:
    """Advise a law for the first run: the one by which it probably ends first.

    Args:
        seconds: what a run by RVEs takes, as of `seconds_by_rves`.
        at_rest: whether it is a rest by load steps.
    """
    cells = recipe.cells.values()
    has_files = all(cell.samples.file and cell.training_file for cell in cells)
    # Without a range neither a surrogate nor a table can be made.
    if any(cell.range is None for cell in cells):
        return "rve"
    # A trained surrogate costs nothing more.
    if has_files and all(is_trained(study) for study in recipe.studies().values()):
        return "cached"
    # A short run by RVEs ends before anything is learnt.
    if seconds < _SECONDS_TO_LEARN:
        return "rve"
    # A table learns during the run, but not with every solver of RVEs.
    takes_table = not study_faults(recipe, ("table",))
    # A table of a rest learns from some thousand RVEs on its path, a surrogate from as many and
    # minutes of training.
    if at_rest and takes_table:
        return "table"
    # The recipe names files for data and training, so its author wants a surrogate.
    if has_files:
        return "cached"
    return "table" if takes_table else "rve"


def proposed_range(met: MetRange, margin: float = MARGIN) -> SamplingRange:
    """Propose the range of `margin` times more strain and rate than was met, rounded outward.

    Raises:
        InputError: the margin is negative, nothing was strained, or a cell would have no length.
    """
    if not (math.isfinite(margin) and margin >= 0.0):
        raise InputError(f"--margin: {margin}; it must be a number of at least 0")
    low, high = met.stretch
    shorter, longer, shear, rate = (
        _rounded_up((1.0 + margin) * value)
        for value in (1.0 - low, high - 1.0, met.shear, met.rate)
    )
    # all of these are 0 or positive
    if not shorter + longer > 0.0:
        raise InputError("range: the run met no strain; something must load or move the tissue")
    if shorter + shear >= 1.0:
        raise InputError(
            f"range: the run met stretches down to {low:.4g} and shear up to {met.shear:.4g}; "
            f"with a margin of {margin:g} no cell would be left; lower the load or the margin"
        )
    stretch = (_plain(1.0 - shorter), _plain(1.0 + longer))
    # at rest nothing has a rate, but samples and records need some neighbours along it
    return SamplingRange(stretch=stretch, shear=shear, rate=max(rate, LEAST_RATE))


def range_section(range: SamplingRange, cell: CellName = None) -> str:
    """Return the section of a range in TOML, for the only cell of a recipe or for a named one."""
    low, high = range.stretch
    name = "range" if cell is None else f"cells.{cell}.range"
    return f"[{name}]\nstretch = [{low}, {high}]\nshear = {range.shear}\nrate = {range.rate}"


def _rounded_up(value: float) -> float:
    """Round up to two significant digits; 0 where the value is not positive."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    # a value of two digits that rounding has put just above them stays what it is
    return _plain(math.ceil(value / unit * (1.0 - 1e-9)) * unit)


def _plain(value: float) -> float:
    """Round away the last digits of binary sums: 0.30000000000000004 becomes 0.3."""
    return float(f"{value:.12g}")
