"""A bound of a surrogate's error, calibrated by true answers along paths it has not seen."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace

import numpy as np

from surrofe2.errors import InputError, SimulationError
from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings, Problem, simulate
from surrofe2.macro.settings import SECTION_6_2
from surrofe2.recipe import Recipe
from surrofe2.rve import RveLaw
from surrofe2.sampling import SamplingRange
from surrofe2.stress_law import StressLaw
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate import SurrogateLaw
from surrofe2.surrogate.calibration import Truth
from surrofe2.surrogate.calibration import calibrate as calibrate_by
from surrofe2.surrogate.deformation_paths import (
    DeformationPaths,
    State,
    WatchedLaw,
    random_corners,
    random_loads,
    random_small_states,
    random_states,
    random_walks,
    run_paths,
    true_stress,
)
from surrofe2.surrogate.error_bound import Calibration
from surrofe2.surrogate.settings import CalibrationSettings
from surrofe2.tensors import stress_spread
from surrofe2.workflow import laws
from surrofe2.workflow.cell_laws import law_by_region
from surrofe2.workflow.run_lifecycle import Report, untold
from surrofe2.workflow.varied_loads import varied_problems

_MOST_ELEMENTS = 4  # of a rectangle in each direction, in runs that make paths
_SHAPING = 1.0 / 3.0  # paths that shape the local scale, for each that calibrates it


_MARGIN = 0.75  # of the bound wanted: the paths that calibrate are others

log = logging.getLogger(__name__)

Runs = Callable[[int, int], Iterator[list[State]]]
"""What so many runs by a seed meet, one after the other."""


def calibrate_surrogate(
    recipe: Recipe,
    surrogate: SurrogateLaw,
    samples: StressSamples,
    report: Report,
    known: Sequence[Truth] = (),
) -> SurrogateLaw:
    """The surrogate with a calibrated bound, by true answers along paths of the recipe.

    Args:
        samples: that it was trained on.
        report: called with the share that is done, up to 1, and a remark.
        known: what `shaping_truths` gave.
    """
    return _calibrated(
        surrogate,
        samples,
        laws.true_law(recipe),
        recipe.calibration,
        lambda count, seed: _runs(recipe, surrogate, count, seed),
        report,
        known,
    )


def shaping_truths(recipe: Recipe, samples: StressSamples) -> list[Truth]:
    """True answers along the paths in the range that will shape the bound; none where the recipe
    wants no bound of its training.

    Raises:
        InputError: a bound is wanted, and there are no such paths.
    """
    if not recipe.training.bound:
        return []
    law, settings = laws.true_law(recipe), replace(recipe.calibration, runs=0)
    if not (settings.walks or settings.states):
        raise InputError(
            f"training.bound: {recipe.training.bound:g}; it must be 0 where calibration.walks and "
            "calibration.states are"
        )
    paths = _make_paths(samples.range, settings, lambda *_: iter(()), 1, _SHAPING, untold)
    return [_ask(each, law, lambda _: None) for each in paths]


@dataclass(frozen=True, slots=True)
class WantedBound:
    """The bound that a recipe's training wants, by true answers along the paths that shape it.

    Those that calibrate it are not looked at, so what it promises does not depend on when
    training ended.
    """

    recipe: Recipe
    samples: StressSamples
    truths: Sequence[Truth]

    def share_of(self, surrogate: SurrogateLaw) -> float:
        """The surrogate's bound over what it is to be, a part of the one wanted; at most 1 where it
        is met, infinite where there is none.
        """
        fewest = min((truth.paths.count for truth in self.truths), default=0)
        share = max(self.recipe.calibration.share, 1.0 / (1.0 + fewest))
        bounded = calibrate_by(surrogate, self.samples, self.truths, self.truths, share)
        wanted = self.recipe.training.bound * stress_spread(self.samples.valid.stress)
        return _edge(bounded, self.samples) / (_MARGIN * wanted)


def calibrate(
    surrogate: SurrogateLaw,
    samples: StressSamples,
    law: StressLaw | None = None,
    settings: CalibrationSettings | None = None,
    *,
    problem: Problem | LoadCase | None = None,
    macro: MacroSettings = SECTION_6_2,
    report: Report = untold,
) -> SurrogateLaw:
    """The surrogate with the bound of its error, without which a `CachedLaw` never trusts it.

    True answers along paths that it has not seen give the bound; `surrogate.calibration` says
    what it promises, `workflow.calibrate.bound_summary` what was found.

    Args:
        samples: that it was trained on; walks and single states are drawn from their range.
        law: the true one; None: the RVEs of the samples.
        settings: how many paths of which kind.
        problem: whose runs under other loads are paths too; None: the paper's bar.
        macro: settings of these runs. A bar has 4 × 4 elements at most.
        report: called with the share that is done, up to 1, and a remark.

    Raises:
        InputError: no path to calibrate on.
    """

    def runs(count: int, seed: int) -> Iterator[list[State]]:
        few = _coarse(macro)
        cases: Iterable[Problem | LoadCase]
        if isinstance(problem, Problem):
            cases = varied_problems(problem, count, seed)
        else:
            cases = random_loads(problem or LoadCase(), count, seed)
        return (_states_met(each, surrogate, few) for each in cases)

    law = law or RveLaw(samples.cell, initialisation=samples.initialisation)
    settings = settings or CalibrationSettings()
    surrogate = _calibrated(surrogate, samples, law, settings, runs, report)
    why = _unbounded(surrogate)
    if why:
        log.warning("bound: none, because %s", why)
    return surrogate


def _calibrated(
    surrogate: SurrogateLaw,
    samples: StressSamples,
    law: StressLaw,
    settings: CalibrationSettings,
    runs: Runs,
    report: Report,
    known: Sequence[Truth] = (),
) -> SurrogateLaw:
    shaping, testing = (
        list(_make_paths(samples.range, settings, runs, seed, share, report))
        for seed, share in ((1, _SHAPING), (0, 1.0))
    )
    shaping = shaping[len(known) :]
    total = sum(len(paths.states[0]) for paths in (*shaping, *testing))
    done = 0

    def asked(paths: DeformationPaths) -> Truth:
        nonlocal done
        truth = _ask(paths, law, lambda k: report((done + k) / max(total, 1), "true stresses"))
        done += len(truth.status)
        return truth

    shapes, tests = ([asked(paths) for paths in part] for part in (shaping, testing))
    shapes = [*known, *shapes]
    return calibrate_by(surrogate, samples, shapes, tests, settings.share, asdict(settings))


def _make_paths(
    range: SamplingRange,
    settings: CalibrationSettings,
    runs: Runs,
    stream: int,
    share: float,
    report: Report,
) -> Iterator[DeformationPaths]:
    """Paths of every kind that is asked for; one `stream` knows nothing of another."""
    wanted = settings.walks, settings.states, settings.runs
    walks, states, count = (int(np.ceil(share * number)) for number in wanted)
    seeds = np.random.SeedSequence([settings.seed, stream]).generate_state(5).tolist()
    if walks:
        yield random_walks(range, walks, settings.length, seeds[0])
    if states:
        yield random_states(range, states, seeds[1])
        yield random_corners(range, states, seeds[3])
        yield random_small_states(range, states, seeds[4])
    if count:
        met = []
        for along_a_run in runs(count, seeds[2]):
            met.append(along_a_run)
            report(0.0, f"run {len(met)} of {count}")
        yield run_paths(met, -(-settings.length // 3))


def _coarse(macro: MacroSettings) -> MacroSettings:
    along, across = (min(n, _MOST_ELEMENTS) for n in macro.elements)
    return replace(macro, elements=(along, across), frames=2, record_dissipation=False)


def _runs(recipe: Recipe, surrogate: SurrogateLaw, count: int, seed: int) -> Iterator[list[State]]:
    """What runs of the recipe's problem under other loads meet at the points of its cell.

    Points of other cells follow the quadratic law of their RVE at rest.
    """
    macro = _coarse(recipe.macro)
    if recipe.stated is None:
        macro = replace(macro, integrator="explicit")
        for load in random_loads(recipe.bar_load(), count, seed):
            yield _states_met(load, surrogate, macro)
        return
    problem, whole = _coarse_problem(recipe), recipe.whole()
    others = {
        name: laws.quadratic_law(part)
        for name, part in whole.parts().items()
        if name != (recipe.cell_name or "")
    }

    def tissue(watched: StressLaw) -> StressLaw:
        return law_by_region(
            whole, problem.mesh, lambda part: others.get(part.cell_name or "", watched)
        )

    for each in varied_problems(problem, count, seed):
        yield _states_met(each, surrogate, macro, tissue)


def _coarse_problem(recipe: Recipe) -> Problem:
    """The recipe's problem on a coarser mesh, where that is a rectangle of one cell and has all it
    names."""
    whole, stated = recipe.whole(), recipe.stated
    assert stated is not None
    if stated.mesh.elements is not None and not whole.types:
        along, across = (min(n, _MOST_ELEMENTS) for n in stated.mesh.elements)
        mesh = replace(stated.mesh, elements=(along, across))
        with suppress(InputError):
            return replace(whole, stated=replace(stated, mesh=mesh)).problem()
    return whole.problem()


def _states_met(
    load: LoadCase | Problem,
    surrogate: StressLaw,
    macro: MacroSettings,
    tissue: Callable[[StressLaw], StressLaw] = lambda watched: watched,
) -> list[State]:
    """(F, F_dot) of the surrogate's points at the steps of a run, while they are in its range.

    Args:
        tissue: the law of all points, by that of the surrogate's.
    """
    met: list[State] = []
    watched = WatchedLaw(surrogate, lambda F, F_dot: met.append((F.copy(), F_dot.copy())))
    with suppress(SimulationError):  # a load beyond the surrogate's range ends the path
        simulate(load, tissue(watched), macro)
    return met


def _ask(paths: DeformationPaths, law: StressLaw, progress: Callable[[int], None]) -> Truth:
    return Truth(paths, *true_stress(paths, law, progress))


def _unbounded(surrogate: SurrogateLaw) -> str:
    """Why the bound is infinite even at rest; empty where it is not."""
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
    return float(surrogate.error_bound(np.eye(2)[None], np.zeros((1, 2, 2)))[0])


def _edge(surrogate: SurrogateLaw, samples: StressSamples) -> float:
    """The largest bound at any sample that the surrogate answers; infinite where it has none."""
    everywhere = surrogate.error_bound(samples.valid.F, samples.valid.F_dot)
    return float(everywhere[np.isfinite(everywhere)].max(initial=_at_rest(surrogate)))


def bound_summary(surrogate: SurrogateLaw, samples: StressSamples) -> str:
    """What the calibration found, in a line or two."""
    why, calibration = _unbounded(surrogate), surrogate.calibration
    if why or calibration is None:
        return f"bound: none, because {why}"
    centre, edge = (
        100.0 * bound / calibration.stress_spread
        for bound in (_at_rest(surrogate), _edge(surrogate, samples))
    )
    paths = sum(kind["paths"] for kind in calibration.kinds.values())
    return (
        f"bound: {centre:.2g} % of the spread of stress at the centre, {edge:.2g} % at the edge, "
        f"{paths} paths, nominal share {100.0 * calibration.share:g} %{_sharpness(calibration)}"
    )


def _sharpness(calibration: Calibration) -> str:
    """How the bound goes with the true error, by kind of path, in words."""
    told = [
        f"{name} {kind['sharpness']:.2g} ({kind['rank_correlation']:.2g})"
        for name, kind in calibration.kinds.items()
        if "sharpness" in kind
    ]
    said = "\nsharpness: median bound over the error that 99 % keep (rank correlation of both): "
    return said + ", ".join(told) if told else ""
