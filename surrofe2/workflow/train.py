"""Training of a surrogate, and the bound of its error by RVEs along paths that it has not seen."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.clock import Meter
from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.base.sampling import SamplingRange
from surrofe2.base.tensors import stress_spread
from surrofe2.law.samples import StressSamples
from surrofe2.law.stress_law import StressLaw
from surrofe2.macro import MacroSettings, simulate
from surrofe2.macro.settings import SECTION_6_2
from surrofe2.macro.system import System, system_of
from surrofe2.problem import Problem
from surrofe2.problem.amplitude import Amplitude, Table, Value
from surrofe2.problem.bar import LoadCase
from surrofe2.problem.conditions import BodyForce, Condition, DrivenCondition, InitialVelocity
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.recipe.recipe import CellStudy, Recipe
from surrofe2.report.tables import percent
from surrofe2.run.loop import Report, Stage, no_report, no_stage
from surrofe2.rve import RveLaw
from surrofe2.store.hdf5 import read, read_seconds, write
from surrofe2.store.samples import stored_count
from surrofe2.store.store import START_OVER, check_same, file_lock, locked_file, remove
from surrofe2.store.surrogates import TRAINING, read_surrogate, write_surrogate
from surrofe2.surrogate import SurrogateLaw
from surrofe2.surrogate.calibration import calibrate as calibrate_by
from surrofe2.surrogate.deformation_paths import (
    DeformationPaths,
    State,
    Truth,
    WatchedLaw,
    random_walks,
    run_paths,
    true_stress,
)
from surrofe2.surrogate.settings import (
    MARGIN,
    RUN_ELEMENTS,
    RUN_POINTS,
    SHAPING_RUNS,
    SHAPING_WALKS,
    WISH,
    CalibrationSettings,
)
from surrofe2.workflow import laws
from surrofe2.workflow.generate import Generated, generate_data_set, training_samples, wanted_count
from surrofe2.workflow.laws import law_by_region

if TYPE_CHECKING:
    from surrofe2.surrogate.training import TrainingState

log = logging.getLogger(__name__)

# Varied problems, whose runs make paths (`varied_problems`): the factor of each amplitude or
# velocity, uniform between these bounds, and the pace of all amplitudes, its logarithm uniform
# between these.
FACTOR = (0.25, 1.5)
PACE = (0.5, 2.0)
# Runs of the paper's bar under random body forces (`random_loads`): the factor of the force,
# uniform between these bounds; points of its amplitude; the longest duration, µs, half a period of
# the bar.
LOAD_FACTOR = (0.25, 3.0)
LOAD_TIMES = 4
LONGEST_RUN = 25.0
# A function that runs as many varied problems as its first argument says, by a seed, and yields the
# states that each of them meets.
Runs = Callable[[int, int], Iterator[list[State]]]

# Components of a stress, as errors name them.
STRESSES = ("xx", "xy", "yx", "yy")
# Held-out RMS of a component over its spread, from which on training warns.
LARGE_ERROR = 0.01
# Twice as many samples are taken again only where they have brought the bound down to this
# fraction.
_HELPS = 0.8
# Array of an unfinished training: the bound that fewer samples gave.
_BEFORE = "bound_before"


@dataclass(frozen=True, slots=True)
class Trained:
    """A trained surrogate and its file.

    Attributes:
        path: its file.
        surrogate: the law.
        kept: whether it was there already.
        bound: lines on the bound of its error.
        samples: those that it was trained on, failed ones included.
    """

    path: Path
    surrogate: SurrogateLaw
    kept: bool
    bound: str
    samples: StressSamples


def train_surrogate(
    study: CellStudy,
    *,
    fresh: bool = False,
    add: Sequence[Path] = (),
    range: SamplingRange | None = None,
    stage: Stage = no_stage,
) -> Trained:
    """Train on a plant cell's data set, calibrate the bound and write the surrogate.

    As long as the bound is above the one wanted and more samples have helped, training is repeated
    on twice as many. The surrogate is written before its calibration too, with no bound yet.

    Args:
        fresh: train again where a surrogate is there.
        add: harvests to train on too.
        range: of the surrogate, where it is not the recipe's.
        stage: reports the stages and their progress.

    Raises:
        InputError: PyTorch is not installed, or a bound is wanted and calibration has no walks.
        MismatchError: data set, surrogate or interrupted training are of other settings or data.
    """
    if find_spec("torch") is None:
        raise InputError("training needs PyTorch, which is not installed: pip install torch")
    settings = study.cell.training
    if settings.bound and not study.recipe.calibration.walks:
        raise InputError(
            f"training.bound: {settings.bound:g}; it must be 0 where calibration.walks is"
        )
    path = study.training_path()
    unfinished = unfinished_training(study)
    counts = study.cell.samples.counts(settings.bound)

    @cache
    def take(count: int) -> StressSamples:
        """Return so many samples of the data set, in the range that was asked for."""
        samples = training_samples(study, count, add, stage=stage)
        return samples if range is None else replace(samples, range=range)

    surrogate = None
    begun = _Begun()
    fingerprint = ""  # of the samples that an earlier training took; empty without one
    if unfinished.exists() and not fresh:
        begun = _read_unfinished(unfinished)
        if begun.state is not None:
            fingerprint = begun.state.identity.get("data_fingerprint", "")
    elif path.exists() and not fresh:
        surrogate = read_surrogate(path)
        fingerprint = surrogate.data_fingerprint
    samples = take(counts[0])
    number = _number_of_counts(study, counts, fingerprint, take)
    samples = take(counts[number])

    def trained(surrogate: SurrogateLaw, *, kept: bool) -> Trained:
        """Return the result with a summary of the bound."""
        bound = bound_summary(surrogate, samples, study.recipe.cache.tolerance)
        return Trained(path, surrogate, kept, bound, samples)

    if surrogate is not None:
        _check_surrogate(study, surrogate, samples)
        if surrogate.is_calibrated and not file_lock(path).exists():
            return trained(surrogate, kept=True)
    with locked_file(path):
        if surrogate is not None and surrogate.is_calibrated:  # killed after its last file
            return trained(surrogate, kept=True)
        law = laws.true_law(study)
        shaping: Sequence[Truth] = ()
        if surrogate is None:
            if fresh:
                remove(unfinished)
            surrogate, samples, shaping = _train_on_more(
                study, counts[number:], take, law, begun, stage
            )
            data_files = (study.data_path(), *add)
            seconds = {**_seconds_of_data(data_files), **surrogate.seconds}
            surrogate = replace(surrogate, seconds=seconds)
            write_surrogate(surrogate, path)
            remove(unfinished)
        surrogate = _calibrate(study, surrogate, samples, law, shaping, stage)
        write_surrogate(surrogate, path)
    return trained(surrogate, kept=False)


def _number_of_counts(
    study: CellStudy,
    counts: Sequence[int],
    fingerprint: str,
    take: Callable[[int], StressSamples],
) -> int:
    """Return which of the counts of samples an earlier training had come to; 0 if none is known.

    Args:
        counts: numbers of samples that training takes in turn.
        fingerprint: of the samples that it took; empty without an earlier training.
        take: returns so many samples.
    """
    if len(counts) == 1 or not fingerprint:
        return 0
    stored = stored_count(study.data_path()).rows
    for number, count in enumerate(counts):
        if count <= stored and take(count).fingerprint == fingerprint:
            return number
    return 0


def _train_on_more(
    study: CellStudy,
    counts: Sequence[int],
    take: Callable[[int], StressSamples],
    law: StressLaw,
    begun: _Begun,
    stage: Stage,
) -> tuple[SurrogateLaw, StressSamples, Sequence[Truth]]:
    """Train on more and more samples, until the bound is met or more samples do not help.

    Args:
        counts: numbers of samples that are taken in turn.
        take: returns so many samples.
        law: the RVEs.
        begun: state of an interrupted training on the first of the counts.

    Returns:
        The surrogate with the seconds of its `training`, its samples, and the paths that shaped
        its bound.
    """
    settings = study.cell.training
    shaping: Sequence[Truth] = ()
    for count in counts:
        samples = take(count)
        with stage("train", settings.iterations, "iterations") as report:
            if settings.bound and not shaping:
                shaping = shaping_truths(samples, law, study.recipe.calibration)
            surrogate, bound, seconds = _train(study, samples, shaping, begun, report)
        is_met = bound <= WISH * settings.bound
        has_not_helped = bound >= _HELPS * begun.before
        if is_met or has_not_helped:
            break
        begun = _Begun(seconds=seconds, before=bound)
    return replace(surrogate, seconds={"training": seconds}), samples, shaping


def _seconds_of_data(files: Sequence[Path]) -> dict[str, float]:
    """Return the seconds that data files took, as an entry `data`; none where one is not known."""
    seconds = [read_seconds(file) for file in files]
    if None in seconds:
        return {}
    return {"data": sum(part or 0.0 for part in seconds)}


def _calibrate(
    study: CellStudy,
    surrogate: SurrogateLaw,
    samples: StressSamples,
    law: StressLaw,
    shaping: Sequence[Truth],
    stage: Stage,
) -> SurrogateLaw:
    """Return the surrogate with the bound of its error, and the seconds of the `calibration`."""
    meter = Meter()
    with stage("calibrate", 1.0, "of the paths") as report:
        surrogate = calibrate(
            surrogate,
            samples,
            law,
            study.recipe.calibration,
            report=report,
            shaping=shaping,
            runs=partial(_runs, study, surrogate),
        )
    return replace(surrogate, seconds={**surrogate.seconds, "calibration": meter.seconds})


def learn(
    study: CellStudy, *, fresh: bool = False, stage: Stage = no_stage
) -> tuple[Generated, Trained]:
    """Make the data set and the surrogate of a plant cell, whatever is missing of both."""
    count = wanted_count(study, fresh=fresh)
    with stage(study.title("generate"), count, "samples") as report:
        data = generate_data_set(study, fresh=fresh, report=report)
    return data, train_surrogate(study, fresh=fresh, stage=stage)


def is_trained(study: CellStudy) -> bool:
    """Return whether the surrogate of a plant cell is there, whole and with its bound."""
    path = study.training_path()
    is_whole = path.exists() and not unfinished_training(study).exists()
    return is_whole and read_surrogate(path).is_calibrated


def unfinished_training(study: CellStudy) -> Path:
    """Return the path of what a training leaves to resume from.

    While it is there, no surrogate is finished.
    """
    return study.training_path().with_suffix(".unfinished.h5")


@dataclass(frozen=True, slots=True)
class _Begun:
    """The state that an interrupted training left.

    Attributes:
        state: iterations and weights; None: it begins.
        seconds: what it has taken so far.
        before: bound that a training on fewer samples gave before it; infinite of the first one.
    """

    state: TrainingState | None = None
    seconds: float = 0.0
    before: float = math.inf


def _read_unfinished(path: Path) -> _Begun:
    """Read the state that an interrupted training left."""
    from surrofe2.surrogate.training import TrainingState  # torch, which runs do without

    header, arrays = read(path, TRAINING)
    before = float(arrays.pop(_BEFORE, math.inf))
    state = TrainingState(header["identity"], header["iterations"], arrays)
    return _Begun(state, header["seconds"], before)


def _train(
    study: CellStudy,
    samples: StressSamples,
    shaping: Sequence[Truth],
    begun: _Begun,
    report: Report,
) -> tuple[SurrogateLaw, float, float]:
    """Train on these samples, from an interrupted state or from the beginning.

    Args:
        shaping: paths that shape the bound, see `shaped_bound`.

    Returns:
        The surrogate; its bound over the spread of stress, 0 where none is wanted; the seconds so
        far.
    """
    path = unfinished_training(study)
    wanted = WISH * study.cell.training.bound
    meter = Meter(begun.seconds)

    from surrofe2.surrogate.training import train

    def keep(state: TrainingState) -> None:
        """Write the state of the training, to resume from."""
        arrays = {**state.arrays, _BEFORE: np.array(begun.before)}
        header = {"identity": state.identity, "iterations": state.iterations}
        write(path, TRAINING, {**header, "seconds": meter.seconds}, arrays)

    bounds: dict[str, float] = {}  # by the surrogate's weights

    def bound_of(surrogate: SurrogateLaw) -> float:
        """Return the bound of a surrogate, computed once for its weights; 0: none is wanted."""
        weights = surrogate.network.fingerprint(surrogate.range)
        if wanted and weights not in bounds:
            bounds[weights] = shaped_bound(surrogate, samples, shaping)
        return bounds.get(weights, 0.0)

    try:
        surrogate = train(
            samples,
            study.cell.training,
            progress=lambda i, n, figures: report(
                i, f"held-out error {100 * figures['held_out_rms']:.2g} %"
            ),
            checkpoint=keep,
            resume=begun.state,
            should_stop=(lambda surrogate: bound_of(surrogate) <= wanted) if wanted else None,
        )
    except MismatchError as error:
        raise MismatchError(f"{path}: {error}; {START_OVER}") from None
    return surrogate, bound_of(surrogate), meter.seconds


def _check_surrogate(study: CellStudy, surrogate: SurrogateLaw, samples: StressSamples) -> None:
    """Refuse to keep a surrogate of other data or settings."""
    path = study.training_path()
    if surrogate.data_fingerprint != samples.fingerprint:
        raise MismatchError(f"{path}: it was trained on other samples; {START_OVER}")
    wanted = {"training": asdict(study.cell.training)}
    stored = {"training": asdict(surrogate.settings)}
    if surrogate.is_calibrated and surrogate.calibration is not None:
        wanted["calibration"] = asdict(study.recipe.calibration)
        stored["calibration"] = dict(surrogate.calibration.settings)
    check_same(path, wanted, stored)


def large_errors(study: CellStudy, trained: Trained) -> str | None:
    """Advise what to do where a component's error is so large that much will be left to RVEs."""
    rms = trained.surrogate.errors["rms"]
    name = max(STRESSES, key=lambda component: rms[component])
    if rms[name] <= LARGE_ERROR:
        return None
    sampled = study.section("range")
    samples = study.section("samples")
    more = "state" if study.cell.samples.count is None else "raise"
    return (
        f"{trained.path}: the error of {name} is {100 * rms[name]:.2g} % RMS, from "
        f"{len(trained.samples.valid.F)} usable samples: narrow {sampled} to what "
        f"`surrofe2 check` proposes, {more} {samples}.count, or let "
        "`surrofe2 refine` sample what the run meets"
    )


def training_summary(trained: Trained) -> str:
    """Summarise the largest held-out errors of a surrogate in a line."""
    errors = trained.surrogate.errors
    rms = max(errors["rms"][name] for name in STRESSES)
    worst = max(errors["worst"][name] for name in STRESSES)
    kept = " (already trained)" if trained.kept else ""
    errors_text = f"{100 * rms:.2g} % RMS, {100 * worst:.2g} % worst"
    return f"held-out errors up to {errors_text}, from {len(trained.samples.F)} samples{kept}"


# The bound.


def calibrate(
    surrogate: SurrogateLaw,
    samples: StressSamples,
    law: StressLaw | None = None,
    settings: CalibrationSettings | None = None,
    *,
    problem: Problem | None = None,
    macro: MacroSettings = SECTION_6_2,
    report: Report = no_report,
    shaping: Sequence[Truth] = (),
    runs: Runs | None = None,
) -> SurrogateLaw:
    """Give a surrogate the bound of its error, without which a `CachedLaw` never trusts it.

    RVEs along paths that it has not seen give the bound; `surrogate.calibration` says what it
    promises, `bound_summary` what was found.

    Args:
        samples: those that it was trained on; walks are drawn from their range.
        law: the full model; None: the RVEs of the samples.
        settings: how many paths of which kind.
        problem: its runs under other loads are paths too; None: the paper's bar.
        macro: settings of these runs; the paper's bar has 2 × 2 elements.
        report: called with the fraction that is done, up to 1, and a remark.
        shaping: as of `shaping_truths`, which computes it where it is left out.
        runs: instead of those of `problem`.

    Raises:
        InputError: no path to calibrate on.
    """
    law = law or RveLaw(samples.cell, initialisation=samples.initialisation)
    settings = settings or CalibrationSettings()
    if runs is None:

        def runs(count: int, seed: int) -> Iterator[list[State]]:
            """Run the problem, or the bar, under other loads."""
            bar = LoadCase(elements=(RUN_ELEMENTS, RUN_ELEMENTS))
            vary = varied_problems if problem else random_loads
            return _met_in_runs(surrogate, vary(problem or bar, count, seed), macro, seed)

    # Which samples there are may depend on what another surrogate did along paths of this seed
    # (`refine`), so these samples choose the paths that calibrate.
    drawn = np.random.SeedSequence([settings.seed, 0, int(samples.fingerprint, 16)])
    walk_seed, run_seed, shaping_seed = drawn.generate_state(3).tolist()

    def run_kind(count: int, seed: int) -> DeformationPaths:
        """Make paths of the states that runs meet."""
        met = []
        for along_a_run in runs(count, seed):
            met.append(along_a_run)
            report(0.0, f"run {len(met)} of {count}")
        return run_paths(met, math.ceil(settings.length / 3))

    shaping = [*(shaping or shaping_truths(samples, law, settings))]
    shapes = []
    tests = []
    if settings.walks:
        tests.append(random_walks(samples.range, settings.walks, settings.length, walk_seed))
    if settings.runs:
        shapes.append(run_kind(int(np.ceil(SHAPING_RUNS * settings.runs)), shaping_seed))
        tests.append(run_kind(settings.runs, run_seed))
    total = sum(len(paths.states[0]) for paths in (*shapes, *tests))
    done = 0

    def solved(paths: DeformationPaths) -> Truth:
        """Compute the RVEs' stresses along paths."""
        nonlocal done
        truth = true_stress(
            paths, law, lambda k: report((done + k) / max(total, 1), "stresses of RVEs")
        )
        done += len(truth.status)
        return truth

    shaping += [solved(paths) for paths in shapes]
    testing = [solved(paths) for paths in tests]
    bounded = calibrate_by(surrogate, samples, shaping, testing, settings.alpha, asdict(settings))
    why = _unbounded(bounded)
    if why:
        log.warning("bound: none, because %s", why)
    return bounded


def shaping_truths(
    samples: StressSamples, law: StressLaw, settings: CalibrationSettings
) -> list[Truth]:
    """Compute RVEs' stresses along the walks that shape the bound.

    Training may look at these, since the bound's promise rests on the paths that calibrate it.
    """
    count = int(np.ceil(SHAPING_WALKS * settings.walks))
    (seed,) = np.random.SeedSequence([settings.seed, 1]).generate_state(1).tolist()
    walks = random_walks(samples.range, count, settings.length, seed)
    return [true_stress(walks, law)] if count else []


def shaped_bound(
    surrogate: SurrogateLaw, samples: StressSamples, shaping: Sequence[Truth]
) -> float:
    """Compute the largest bound within the domain that the shaping paths alone would give.

    It is relative to the spread of stress; infinite where they give none.
    """
    # the smallest α that so few paths can support
    alpha = 1.0 / (1.0 + min(truth.paths.count for truth in shaping))
    bounded = calibrate_by(surrogate, samples, shaping, shaping, alpha)
    return _edge(bounded, samples) / stress_spread(samples.valid.stress)


def _runs(
    study: CellStudy, surrogate: SurrogateLaw, count: int, seed: int
) -> Iterator[list[State]]:
    """Yield what runs under other loads meet at points of a cell.

    All other cells of the recipe follow their quadratic law.
    """
    recipe = study.recipe
    problem = _coarse_problem(recipe)
    macro = recipe.macro
    cases = varied_problems(problem, count, seed)
    if recipe.is_bar:
        cases = random_loads(problem, count, seed)
        macro = replace(macro, integrator="explicit")
    others = {
        name: laws.quadratic_law(other)
        for name, other in recipe.studies().items()
        if name != study.name
    }

    def tissue(watched: StressLaw) -> StressLaw:
        """Make the law of all points from that of the cell's own."""
        return law_by_region(recipe, problem.mesh, lambda study: others.get(study.name, watched))

    return _met_in_runs(surrogate, cases, macro, seed, tissue)


def _coarse_problem(recipe: Recipe) -> Problem:
    """Make the recipe's problem, on a coarser mesh where that is a rectangle with all it names."""
    mesh = recipe.mesh
    if mesh.elements is not None and len(recipe.cells) == 1:
        along, across = (min(n, RUN_ELEMENTS) for n in mesh.elements)
        with suppress(InputError):  # a coarse mesh may lack a part of the boundary
            return replace(recipe, mesh=replace(mesh, elements=(along, across))).problem()
    return recipe.problem()


def _met_in_runs(
    surrogate: StressLaw,
    cases: Iterable[Problem],
    macro: MacroSettings,
    seed: int,
    tissue: Callable[[StressLaw], StressLaw] = lambda watched: watched,
) -> Iterator[list[State]]:
    """Run problems, and yield the states (F, F_dot) that some points meet in each, step by step.

    A run ends where it leaves the surrogate's range.

    Args:
        surrogate: the law at the points that are watched.
        cases: the problems.
        seed: of the choice of points.
        tissue: makes the law of all points from the watched one.
    """
    macro = replace(macro, frames=2, record_dissipation=False)
    met: list[State] = []
    points: Index | None = None
    system: System | None = None

    def note(F: Array, F_dot: Array) -> None:
        """Record a step at the chosen points."""
        nonlocal points
        if points is None:
            points = np.random.default_rng(seed).permutation(len(F))[:RUN_POINTS]
        met.append((F[points], F_dot[points]))

    law = tissue(WatchedLaw(surrogate, note))
    for case in cases:
        met = []
        system = system_of(case, law) if system is None else system.under(case)
        with suppress(SimulationError):  # a load beyond the surrogate's range ends the path
            simulate(case, law, macro, system=system)
        yield met


def _unbounded(surrogate: SurrogateLaw) -> str:
    """Say why the bound is infinite even at rest; empty where it is not."""
    calibration = surrogate.calibration
    if calibration is None or not np.isfinite(calibration.quantile):
        return (
            "the RVE has no stress on too many paths within the domain; "
            "narrow [range] or generate more samples"
        )
    if np.isfinite(_at_rest(surrogate)):
        return ""
    return (
        "the samples that failed or left a bifurcation leave no domain even at rest, "
        "and every point of a cached run would go to its RVE; narrow [range]"
    )


def _at_rest(surrogate: SurrogateLaw) -> float:
    """Return the bound of the error at rest, µN/µm."""
    return float(surrogate.error_bound(np.eye(2)[None], np.zeros((1, 2, 2)))[0])


def _edge(surrogate: SurrogateLaw, samples: StressSamples) -> float:
    """Return the largest bound at any sample that the surrogate answers; infinite without any."""
    everywhere = surrogate.error_bound(samples.valid.F, samples.valid.F_dot)
    return float(everywhere[np.isfinite(everywhere)].max(initial=_at_rest(surrogate)))


def bound_summary(surrogate: SurrogateLaw, samples: StressSamples, tolerance: float) -> str:
    """Summarise the calibration in two lines.

    Args:
        tolerance: of the cache, a fraction of the spread of stress.
    """
    why = _unbounded(surrogate)
    calibration = surrogate.calibration
    if why or calibration is None:
        return f"Error bound: none, because {why}"
    centre, edge = (
        percent(2)(bound / calibration.stress_spread)
        for bound in (_at_rest(surrogate), _edge(surrogate, samples))
    )
    kept = f"{100.0 * (1.0 - calibration.alpha):g} %"
    paths = " and ".join(
        f"{kind['paths']:,} {name}" for name, kind in calibration.kinds.items() if kind["paths"]
    )
    return (
        f"Error bound: {centre} of the stress spread at the centre of the range, {edge} at its "
        f"edge; tolerance {percent(3)(tolerance)}\n"
        f"With {100.0 * calibration.confidence:.2g} % confidence the bound covers {kept} of paths "
        f"like the {paths} that calibrated it; a safety factor of {MARGIN:g} is included"
    )


def random_loads(problem: Problem, count: int, seed: int) -> Iterator[Problem]:
    """Vary the body force of the bar: any direction, coming, going and reversing, up to 25 µs.

    Its modulus is a quarter to three times that of its own, uniform; its factor runs linearly
    through values uniform in [−1, 1], the first of them at once.
    """
    rng = np.random.default_rng(seed)
    *others, load = problem.conditions
    assert isinstance(load, BodyForce)
    modulus = float(np.hypot(*load.acceleration))
    duration = min(problem.duration, LONGEST_RUN)
    times = np.linspace(0.0, duration, LOAD_TIMES)
    for _ in np.arange(count):
        angle = rng.uniform(-np.pi, np.pi)
        factor = rng.uniform(*LOAD_FACTOR)
        force = modulus * factor * np.array([np.cos(angle), np.sin(angle)])
        course = Table(points=tuple((t, rng.uniform(-1.0, 1.0)) for t in times.tolist()))
        varied = replace(load, acceleration=tuple(force.tolist()), amplitude=course)
        yield replace(
            problem, conditions=(*others, varied), duration=duration, output_interval=duration
        )


@dataclass(frozen=True, slots=True)
class Varied(Amplitude):
    """The amplitude factor · amplitude(pace · t)."""

    amplitude: Amplitude
    factor: float
    pace: float

    def at(self, t: float, within: float) -> Value:
        """Compute factor and rates at t, see `Amplitude.at`."""
        factor = self.factor
        pace = self.pace
        value, rate, bend = self.amplitude.at(pace * t, pace * within)
        return factor * value, factor * pace * rate, factor * pace**2 * bend

    def corners(self) -> tuple[float, ...]:
        """Return the corners of the amplitude at this pace, µs."""
        return tuple(t / self.pace for t in self.amplitude.corners())

    @property
    def resolved_by(self) -> float:
        """Longest step that sees the shape of the amplitude, µs."""
        return self.amplitude.resolved_by / self.pace


def varied_problems(problem: Problem, count: int, seed: int) -> Iterator[Problem]:
    """Vary a problem: loads weaker or stronger, and faster or slower with its duration.

    Constant loads and initial velocities vary by their factor alone.
    """
    rng = np.random.default_rng(seed)
    for _ in np.arange(count):
        pace = float(np.exp(rng.uniform(*np.log(PACE))))
        conditions = []
        for condition in problem.conditions:
            conditions.append(_varied(condition, float(rng.uniform(*FACTOR)), pace))
        bodies = []
        for body in problem.bodies:
            bodies.append(_varied(body, float(rng.uniform(*FACTOR)), pace))
        yield replace(
            problem,
            conditions=tuple(conditions),
            bodies=tuple(bodies),
            duration=problem.duration / pace,
            output_interval=problem.duration / pace,
        )


def _varied(stated: Condition | RigidBody, factor: float, pace: float) -> Any:
    """Return a condition or body with its amplitude, or its velocity, varied."""
    # vectors that no amplitude multiplies
    vectors = {InitialVelocity: ("velocity",), RigidBody: ("velocity", "acceleration")}
    changes: dict[str, Any] = {
        name: tuple(factor * value for value in getattr(stated, name))
        for name in vectors.get(type(stated), ())
    }
    if isinstance(stated, DrivenCondition | RigidBody):
        changes["amplitude"] = Varied(stated.amplitude, factor, pace)
    return replace(stated, **changes)
