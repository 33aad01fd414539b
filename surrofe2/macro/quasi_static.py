"""Quasi-static equilibrium: the load in steps, Newton with line search at each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.law.stress_law import StressLaw, require_tangents
from surrofe2.macro.equations_of_motion import EquationsOfMotion, Tally
from surrofe2.macro.equilibrium import Newton, Rest
from surrofe2.macro.evaluation import NoStress, Switched
from surrofe2.macro.extremes import NO_EXTREMES, widen_extremes
from surrofe2.macro.settings import SECTION_6_2, MacroSettings
from surrofe2.macro.system import system_of
from surrofe2.macro.tangents import make_assembly
from surrofe2.problem.problem import Problem

Array = NDArray[np.float64]

MAX_HALVINGS = 10
_SMALLEST_SHARE = 1.0 / 16.0


def find_rest(
    problem: Problem,
    law: StressLaw,
    settings: MacroSettings = SECTION_6_2,
    *,
    factor: float = 1.0,
    load_steps: int = 1,
    reached: Callable[[Rest], None] | None = None,
    resume: Mapping[str, Array] | None = None,
    law_state: Any = None,
) -> Rest:
    """Equilibrium of all forces at v = 0 and `factor` times the loads, reached from factor 0.

    Each load step starts from the last equilibrium; Newton's correction is halved until the
    residual falls and every point has a stress, and a load step that cannot be solved is halved.

    Args:
        problem: as of `simulate`. Its amplitudes in time have no say here.
        factor: of all loads and prescribed motions; 0 is the tissue without load.
        load_steps: load steps to begin with.
        reached: called with each equilibrium on the way, the one without load first.
        resume: `Rest.to_arrays` of an equilibrium of the same problem on the way to the same
            factor, with its `law_state`; what is found is that of the uninterrupted way, to the
            bit.

    Friction depends on the way: a point of contact sticks where it touched until Coulomb's law lets
    it slip, from equilibrium to equilibrium, so more load steps follow its way more closely.

    Raises:
        InputError: the law has no tangents.
        MismatchError: `resume` is of another mesh.
        SimulationError: a load step halved ten times finds no equilibrium; `partial` is the last
            `Rest`.
    """
    require_tangents(law, "rest")
    if not np.isfinite(factor):
        raise InputError(f"factor: {factor}; it must be finite")
    if load_steps < 1:
        raise InputError(f"load_steps: {load_steps}; it must be at least 1")
    system = system_of(problem, law, proportional=True)
    equations = EquationsOfMotion(system, law, clock="load factor {:.6g}")
    if problem.surface is not None and resume is None:
        unloaded = settle(problem, law, settings, equations.tally)
        equations.law_state, system = unloaded.law_state, system.from_rest(unloaded.u)
    elif problem.surface is not None and resume is not None:
        system = system.from_rest(resume["rest"])
    equations.system = system
    newton = Newton(equations, make_assembly(system), settings)
    try:
        if resume is None:
            step, met = factor / load_steps, NO_EXTREMES
            newton = newton.gripping(np.zeros((system.n_rows, 2)), {})
            found = newton.rest_at(0.0, np.zeros(system.free.size))
        else:
            if resume["u"].shape != (system.n_rows, 2):
                raise MismatchError("resume: the mesh is not that of the state; start anew")
            step, met = float(resume["next_step"]), resume["extremes"]
            drags = {each.name: resume[f"drag {each.name}"] for each in system.contacts}
            newton = newton.gripping(resume["u"], drags)
            found = newton.known(resume, law_state)
    except (NoStress, Switched) as failure:
        raise SimulationError(f"the load cannot start: {failure}") from failure
    rest, failed = _on_the_way(found, met, step), False
    if reached is not None and resume is None:
        reached(rest)
    while rest.factor != factor:
        left = factor - rest.factor
        target = factor if abs(step) >= abs(left) * (1.0 - 1e-9) else rest.factor + step
        newton = newton.gripping(rest.u, rest.drags)
        try:
            found = newton.rest_at(target, system.pick(rest.u), rest)
        except NoStress as failure:
            equations.tally.counts["halvings"] += 1
            step, failed = 0.5 * (target - rest.factor), True
            # Counted from the first length: near a limit load every second step would succeed.
            if abs(step) < abs(factor) / load_steps * 0.5**MAX_HALVINGS:
                raise SimulationError(
                    f"no load step succeeds after {MAX_HALVINGS} halvings: {failure}",
                    partial=rest,
                ) from failure
            continue
        step, failed = min(step if failed else 2.0 * step, factor / load_steps, key=abs), False
        rest = _on_the_way(found, rest.extremes, step)
        if reached is not None:
            reached(rest)
    return replace(rest, counts=newton.counts())


@dataclass(frozen=True, slots=True)
class Settled:
    """A tissue at rest under its surface tension alone: displacement (n, 2), zero of rigid bodies,
    and what the law committed there.
    """

    u: Array
    law_state: Any


def settle(problem: Problem, law: StressLaw, settings: MacroSettings, tally: Tally) -> Settled:
    """The rest of a problem with free sides before anything moves it, its bodies away.

    Supports hold what they hold, so that all displacements can count from there. Where Newton's
    method does not come to it at once, the tension grows in steps.

    Args:
        tally: takes in what it costs.

    Raises:
        InputError: the law has no tangents.
        SimulationError: there is no such rest.
    """
    require_tangents(law, "surface")
    system = system_of(replace(problem, bodies=()), law, proportional=True)
    equations = EquationsOfMotion(system, law, clock="before the load")
    equations.tally, assembly = tally, make_assembly(system)
    u, share, step = np.zeros((system.n_rows, 2)), 0.0, 1.0
    while share < 1.0:
        equations.system = system.with_share(share + step)
        newton = Newton(equations, replace(assembly, system=equations.system), settings)
        try:
            u, share = newton.rest_at(0.0, system.pick(u)).u, share + step
        except NoStress as failure:
            step *= 0.5
            if step < _SMALLEST_SHARE:
                raise SimulationError(f"no rest under the surface tension: {failure}") from failure
    away = np.zeros((len(problem.bodies), 2))
    return Settled(np.concatenate([u, away]), equations.law_state)


def _on_the_way(found: Rest, met: Array, next_step: float) -> Rest:
    """An equilibrium with what the load met up to there, and how it goes on."""
    extremes = met.copy()
    widen_extremes(extremes, found.F, np.zeros_like(found.F))
    return replace(found, extremes=extremes, next_step=next_step)
