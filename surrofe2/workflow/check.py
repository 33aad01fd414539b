"""What a recipe will come to, before it is run: its faults, the range it meets, its cost, its law.

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

MARGIN = 0.2
SECONDS = 10.0
"""Processor time of all dry runs of a check; those on the recipe's mesh have half of it."""
MOST_ELEMENTS = 65_536
"""Of a mesh that is checked, so that memory stays below 1 GB; a rectangle of more is coarsened."""
LEAST_RATE = 1e-4
"""Of a proposed range, 1/µs: that of a rest, whose stress has no part by the rate."""
_COARSEST = 4
_FEW_ELEMENTS = 1024
"""Of a mesh on which the time scales are known well enough."""
_LEAST_REACHED = 0.01
"""Of the load of a dry rest, from which on its whole cost is extrapolated."""
_FRAMES = 21
"""Of a dry run, by which its largest displacement is known."""
_TIMED_STEPS = 24
_TIMED_POINTS = 128
_TIMED_SECONDS = 3.0
"""RVEs are timed along the second half of so many last steps of a dry run, since the first are cold
and without a prediction; none is begun after so much processor time."""
_MOST_PARTS = 30
"""Boundaries, or regions, of a mesh that a check lists."""
_LEARNING = 30.0
"""A run by RVEs that is shorter, in s, ends before a data set and a surrogate are made."""


def recipe_faults(path: Path) -> list[str]:
    """An error message for each entry of a recipe that cannot be what it says, all in one go."""
    try:
        load_recipe(path)
    except (FileError, InputError) as error:
        return [f"{path.name}: {fault}" for fault in error.faults] or [str(error)]
    return []


def study_faults(recipe: Recipe, kinds: Sequence[str], *, fresh: bool = False) -> list[str]:
    """What keeps runs of a recipe by these laws from their end: mesh, names, range, files.

    Args:
        fresh: a data set and a surrogate that are there do not count.
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
    """Check mesh and names, and that bodies begin outside the tissue."""
    problem = recipe.problem()
    with recipe.named(InputError):
        check_bodies(problem)


def parts_of_mesh(recipe: Recipe) -> list[str]:
    """A line about the recipe's mesh, and one for each of its boundaries and regions: how many
    sides, elements and nodes are in it, and how long or large it is. A line for each node on which
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
    for name, facets in [*boundaries.items()][:_MOST_PARTS]:
        inner = np.count_nonzero(mesh.f2t[1, facets] != -1)
        within = f", {inner:,} of them within the tissue" if inner else ""
        there = _counted(len(np.unique(facet_nodes(mesh, facets))), "node")
        sides = _counted(len(facets), "side")
        length = length_of(mesh, facets)
        lines.append(f"boundary {name}: {sides}{within}, {there}, {length:,.6g} µm")
    for name, elements in [*regions.items()][:_MOST_PARTS]:
        there = _counted(len(np.unique(nodes[elements])), "node")
        inside = _counted(len(elements), "element")
        lines.append(f"region {name}: {inside}, {there}, {area_of(mesh, elements):,.6g} µm²")
    for what, names in (("boundaries", boundaries), ("regions", regions)):
        if len(names) > _MOST_PARTS:
            lines.append(f"and {len(names) - _MOST_PARTS} more {what}")
    for place in problem.acted_nodes():
        x, y = mesh.p[:, place.node(mesh, "on")]
        acting = [label(each) for each in problem.conditions if each.on == place]
        lines.append(f"node at ({x:.6g}, {y:.6g}) µm: {', '.join(acting)}")
    return lines


def lines_of_cells(recipe: Recipe) -> list[str]:
    """Lines about each of a recipe's plant cells: what experiments would tell of it, and the
    constants that mean the same."""
    lines = []
    for name, each in recipe.cells.items():
        cell = each.parameters
        values = measurements_of(cell)
        units = {item.name: item.metadata["unit"] for item in fields(LivingTissue)}
        measured = [f"{key} {value:.4g} {units[key]}" for key, value in values.items()]
        if "turgor" not in values:
            measured.append("turgor by `surrofe2 moduli`")
        units = {item.name: item.metadata["unit"] for item in fields(CellParameters)}
        # wall_stiffness is of two measurements
        names = dict.fromkeys(each for names in DETERMINED.values() for each in names)
        constants = [f"{key} {getattr(cell, key):.4g} {units[key]}" for key in names]
        lines += [
            f"{'plant cell' if name is None else f'cell {name}'}: {', '.join(measured)}",
            f"  as constants: {', '.join(constants)}",
        ]
    return lines


def _counted(number: int, what: str) -> str:
    """A number of things, in words."""
    return f"{number:,} {what}" if number == 1 else f"{number:,} {what}s"


def _check_files(study: CellStudy) -> None:
    """Check that data set and surrogate, as far as they are there and whole, are of this recipe."""
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
    """How often a run calls its law, and what it meets; dicts are by name of the cell.

    Attributes:
        points: of quadrature; each of the run's `calls` is for all of them.
        reached: fraction of the duration, or of the load, by which `met` is known.
        steps: the last accepted (F, Ḟ), (n, 2, 2) each, of some of a cell's points.
        shares: of a cell among the points.
        with_tangents: whether each call asks for tangents too, as those of a rest.
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
        """RVEs that a run by them solves."""
        return self.calls * self.points


class _CutShort(Exception):  # noqa: N818 - no error
    """As much of a run as was wanted is done."""


class _Recorder(WatchedLaw):
    """The quadratic law of a cell, and a record of its calls."""

    def __init__(self, law: StressLaw) -> None:
        super().__init__(law, self._note)
        self.extremes = NO_EXTREMES.copy()
        self.steps: deque[tuple[Array, Array]] = deque(maxlen=_TIMED_STEPS)
        self.calls = self.points = 0

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        self.calls = self.calls + 1
        self.points = len(F)
        return super().respond(F, F_dot, state, tangents=tangents)

    def _note(self, F: Array, F_dot: Array) -> None:
        widen_extremes(self.extremes, F, F_dot)
        some = slice(None, None, -(-len(F) // _TIMED_POINTS))
        self.steps.append((F[some].copy(), F_dot[some].copy()))


def dry_run(recipe: Recipe, seconds: float = SECONDS, report: Report = no_report) -> DryRun:
    """A dry run of a recipe's problem, in so many seconds of processor time.

    Where half of them do not suffice for the whole run, a rectangle is meshed with half as many
    elements each way, or a quarter, and so on, for the range and the steps; the number of calls is
    that of the recipe's mesh, extrapolated.

    Raises:
        InputError: the mesh is too large, and no rectangle that can be coarsened.
        SimulationError: the run could not be carried on.
    """
    end = cpu_clock() + seconds
    mesh, halvings = checked_mesh(recipe)
    first = best = _dry_run(mesh, 0.5 * seconds, report)
    while best.reached < 1.0 and (left := end - cpu_clock()) > 0.0:
        # half as many elements each way take a sixteenth of the time: a quarter of the points, and
        # steps that viscosity limits by the square of an element's size
        needed = 0.5 * seconds / max(best.reached, 1e-6)
        coarser = _coarser(mesh, max(1, math.ceil(math.log(2.0 * needed / left, 16.0))))
        if coarser is None:
            break
        mesh = coarser
        best = _dry_run(coarser, left, report)
    found = replace(best, points=first.points * 4**halvings, calls=first.calls * 4.0**halvings)
    until = f"what is met after {best.reached * recipe.duration:.3g} of {recipe.duration:g} µs"
    return found if best.reached >= 1.0 else replace(found, omitted=until)


def checked_mesh(recipe: Recipe) -> tuple[Recipe, int]:
    """The recipe on a mesh that can be checked, and how often its elements were merged each way.

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
    """The recipe with fewer elements, halved as often as its names allow; None: not at all."""
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
    problem = recipe.problem()
    law, recorders = _recorded_law(recipe, problem)
    end = cpu_clock() + seconds
    marks = [(0.0, 0)]
    displacement = 0.0

    def progress(t: float, duration: float) -> None:
        report(t, "")
        marks.append((t, max(each.calls for each in recorders.values())))
        if cpu_clock() > end:
            raise _CutShort

    try:
        with suppress(_CutShort), recipe.named(InputError):
            run = simulate(problem, law, replace(recipe.macro, frames=_FRAMES), progress=progress)
            displacement = run.largest_displacement
    except SimulationError as error:
        raise SimulationError(f"check: the dry run by the quadratic law: {error}") from error
    # the first steps are shorter than most: the second half says how the run continues
    t, calls = marks[-1]
    then, before = marks[(len(marks) - 1) // 2]
    remaining = (recipe.duration - t) / (t - then) if t > then else 0.0
    return _tried(
        recorders,
        calls=calls + remaining * (calls - before),
        reached=t / recipe.duration,
        displacement=displacement,
    )


def _recorded_law(recipe: Recipe, problem: Problem) -> tuple[StressLaw, dict[CellName, _Recorder]]:
    """Make the quadratic law of a tissue, and by name of the cell what records it."""
    recorders: dict[CellName, _Recorder] = {}

    def recorded(study: CellStudy) -> StressLaw:
        recorder = _Recorder(laws.quadratic_law(study))
        recorders[study.name] = recorder
        return recorder

    return law_by_region(recipe, problem.mesh, recorded), recorders


def _tried(recorders: Mapping[CellName, _Recorder], **entries: Any) -> DryRun:
    """What was recorded of a dry run, with entries of its own."""
    points = sum(each.points for each in recorders.values())
    return DryRun(
        points=points,
        met={name: MetRange.of(each.extremes) for name, each in recorders.items()},
        steps={name: list(each.steps) for name, each in recorders.items()},
        shares={name: each.points / points for name, each in recorders.items()},
        **entries,
    )


def scales_of(recipe: Recipe) -> TimeScales:
    """The time scales of a recipe, by the tangents of its RVEs at rest on a mesh that is coarsened
    where it can be."""
    mesh, _ = checked_mesh(recipe)
    elements = math.prod(mesh.mesh.elements or (1, 1))
    halvings = math.ceil(0.5 * math.log2(max(1.0, elements / _FEW_ELEMENTS)))
    coarse = (_coarser(mesh, halvings) if halvings else None) or mesh
    problem = coarse.problem()
    law = law_by_region(coarse, problem.mesh, laws.quadratic_law)
    with recipe.named(InputError):
        return time_scales(coarse, problem, law)


def dry_rest(recipe: Recipe, seconds: float = SECONDS, report: Report = no_report) -> DryRun:
    """A rest of a recipe's problem by the quadratic law, in so many seconds of processor time; on
    a coarser mesh where half of them do not suffice, as of `dry_run`.

    Raises:
        InputError: the mesh is too large, and no rectangle that can be coarsened.
        SimulationError: a load step finds no equilibrium.
    """
    end = cpu_clock() + seconds
    mesh, halvings = checked_mesh(recipe)
    first = best = _dry_rest(mesh, 0.5 * seconds, report)
    while best.reached < 1.0 and (left := end - cpu_clock()) > 0.0:
        # half as many elements each way are solved in an eighth of the time
        needed = 0.5 * seconds / max(best.reached, _LEAST_REACHED)
        coarser = _coarser(mesh, max(1, math.ceil(math.log(2.0 * needed / left, 8.0))))
        if coarser is None:
            break
        mesh = coarser
        best = _dry_rest(coarser, left, report)
    found = replace(best, points=first.points * 4**halvings)
    until = f"what is met after {100.0 * best.reached:.3g} % of the load"
    return found if best.reached >= 1.0 else replace(found, omitted=until)


def _dry_rest(recipe: Recipe, seconds: float, report: Report) -> DryRun:
    problem = recipe.problem()
    law, recorders = _recorded_law(recipe, problem)
    settings = recipe.rest or RestSettings()
    end = cpu_clock() + seconds
    reached = 0.0
    displacement = 0.0

    def progress(factor: float, whole: float) -> None:
        nonlocal reached
        reached = factor / whole if whole else 1.0
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
    calls = max(each.calls for each in recorders.values())
    return _tried(
        recorders,
        calls=calls / max(reached, _LEAST_REACHED),
        reached=reached,
        with_tangents=True,
        displacement=displacement,
    )


def seconds_by_rves(recipe: Recipe, run: DryRun) -> float:
    """The order of magnitude of a run by RVEs: its solves times a timed one, along a dry run."""
    return run.solves * sum(
        share
        * _seconds_a_solve(
            laws.true_law(CellStudy(recipe, name)), run.steps[name], run.with_tangents
        )
        for name, share in run.shares.items()
    )


def _seconds_a_solve(law: StressLaw, steps: list[tuple[Array, Array]], tangents: bool) -> float:
    """Seconds of an RVE that is solved from its state one step before."""
    state = None
    times: list[float] = []
    end = cpu_clock() + _TIMED_SECONDS
    for F, F_dot in steps:
        started = clock()
        answer = law.respond(F, F_dot, state, tangents=tangents)
        times.append((clock() - started) / len(F))
        # a stepper repeats a step whose RVEs switch state; here they stay in the new one
        state = law.accept(F, F_dot, replace(answer, switched=None)).state
        if cpu_clock() > end:
            break
    return float(np.median(times[len(times) // 2 :])) if times else 0.0


def advised_law(recipe: Recipe, seconds: float) -> str:
    """The law by which a first run probably ends first, if one by RVEs takes so many seconds."""
    cells = recipe.cells.values()
    has_files = all(cell.samples.file and cell.training_file for cell in cells)
    if any(cell.range is None for cell in cells):
        return "rve"
    if has_files and all(is_trained(study) for study in recipe.studies().values()):
        return "cached"
    if seconds < _LEARNING:
        return "rve"
    if has_files:
        return "cached"
    return "rve" if study_faults(recipe, ("table",)) else "table"


def proposed_range(met: MetRange, margin: float = MARGIN) -> SamplingRange:
    """The range that holds `margin` times more strain and rate than was met, rounded outward.

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
    """Return the section of a range in TOML, as a recipe of [cell] or of several cells has it."""
    low, high = range.stretch
    name = "range" if cell is None else f"cells.{cell}.range"
    return f"[{name}]\nstretch = [{low}, {high}]\nshear = {range.shear}\nrate = {range.rate}"


def _rounded_up(value: float) -> float:
    """The next number of two digits; 0 of what is not positive."""
    if value <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return _plain(math.ceil(value / unit * (1.0 - 1e-9)) * unit)


def _plain(value: float) -> float:
    """Without the rounding of binary sums."""
    return float(f"{value:.12g}")
