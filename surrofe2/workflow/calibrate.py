"""A bound of a surrogate's error, calibrated by true answers along paths it has not seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, replace

import numpy as np

from surrofe2.errors import InputError, SimulationError
from surrofe2.load_case import LoadCase
from surrofe2.macro import MacroSettings, Problem, simulate
from surrofe2.recipe import Recipe
from surrofe2.stress_law import StressLaw
from surrofe2.stress_samples import StressSamples
from surrofe2.surrogate import SurrogateLaw
from surrofe2.surrogate.calibration import Truth, calibrate
from surrofe2.surrogate.deformation_paths import (
    DeformationPaths,
    State,
    WatchedLaw,
    random_loads,
    random_states,
    random_walks,
    run_paths,
    true_stress,
)
from surrofe2.workflow import laws
from surrofe2.workflow.cell_laws import law_by_region
from surrofe2.workflow.run_lifecycle import Report
from surrofe2.workflow.varied_loads import varied_problems

_MOST_ELEMENTS = 4  # of a rectangle in each direction, in runs that make paths
_SHAPING = 1.0 / 3.0  # paths that shape the local scale, for each that calibrates it


def calibrate_surrogate(
    recipe: Recipe, surrogate: SurrogateLaw, samples: StressSamples, report: Report
) -> SurrogateLaw:
    """The surrogate with a calibrated bound, by true answers along paths of the recipe.

    Args:
        samples: that it was trained on.
        report: called with the share that is done, up to 1, and a remark.
    """
    law = laws.true_law(recipe)
    shaping, testing = (
        list(_make_paths(recipe, surrogate, seed, share, report))
        for seed, share in ((1, _SHAPING), (0, 1.0))
    )
    total = sum(len(paths.states[0]) for paths in (*shaping, *testing))
    done = 0

    def asked(paths: DeformationPaths) -> Truth:
        nonlocal done
        truth = _ask(paths, law, lambda k: report((done + k) / max(total, 1), "true stresses"))
        done += len(truth.status)
        return truth

    shapes, tests = ([asked(paths) for paths in part] for part in (shaping, testing))
    settings = recipe.calibration
    return calibrate(surrogate, samples, shapes, tests, settings.share, asdict(settings))


def _make_paths(
    recipe: Recipe, surrogate: SurrogateLaw, stream: int, share: float, report: Report
) -> Iterator[DeformationPaths]:
    """Paths of every kind that the recipe asks for; one `stream` knows nothing of another."""
    settings = recipe.calibration
    walks, states, runs = (
        int(np.ceil(share * count)) for count in (settings.walks, settings.states, settings.runs)
    )
    seeds = np.random.SeedSequence([settings.seed, stream]).generate_state(3).tolist()
    if walks:
        yield random_walks(recipe.sampling_range(), walks, settings.length, seeds[0])
    if states:
        yield random_states(recipe.sampling_range(), states, seeds[1])
    if runs:
        met = []
        for along_a_run in _runs(recipe, surrogate, runs, seeds[2]):
            met.append(along_a_run)
            report(0.0, f"run {len(met)} of {runs}")
        yield run_paths(met, -(-settings.length // 3))


def _runs(recipe: Recipe, surrogate: SurrogateLaw, count: int, seed: int) -> Iterator[list[State]]:
    """What runs of the recipe's problem under other loads meet at the points of its cell.

    Points of other cells follow the quadratic law of their RVE at rest.
    """
    along, across = (min(n, _MOST_ELEMENTS) for n in recipe.macro.elements)
    macro = replace(recipe.macro, elements=(along, across), frames=2, record_dissipation=False)
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


def bound_summary(surrogate: SurrogateLaw, samples: StressSamples) -> str:
    """What the calibration found, in a line."""
    calibration = surrogate.calibration
    if calibration is None or not np.isfinite(calibration.quantile):
        return (
            "bound: none, because the RVE has no stress on too many paths within the domain; "
            "narrow [range] or generate more samples"
        )
    at_rest = surrogate.error_bound(np.eye(2)[None], np.zeros((1, 2, 2)))[0]
    everywhere = surrogate.error_bound(samples.valid.F, samples.valid.F_dot)
    if not np.isfinite(at_rest):
        return (
            "bound: none, because the samples that failed or left a bifurcation leave no domain "
            "even at rest, and every point of a cached run would go to its RVE; narrow [range]"
        )
    edge = everywhere[np.isfinite(everywhere)].max(initial=at_rest)
    centre, edge = (100.0 * bound / calibration.stress_spread for bound in (at_rest, edge))
    paths = sum(kind["paths"] for kind in calibration.kinds.values())
    return (
        f"bound: {centre:.2g} % of the spread of stress at the centre, {edge:.2g} % at the edge, "
        f"{paths} paths, nominal share {100.0 * calibration.share:g} %"
    )
