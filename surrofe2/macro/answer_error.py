"""The error of displacements and forces of a rest that was computed by approximate stresses.

With f(u) the internal force by the RVEs' law, f̃(u) that of the law which was used, l(u) all other
forces and K = ∂(f̃ − l)/∂u at the equilibrium ũ of the latter, Newton's correction is

    δu = −K⁻¹ Δf,    Δf = f(ũ) − f̃(ũ) = Σ_e Δf_e,

summed over elements, of which one that RVEs answered already has Δf_e = 0. Here f̃(ũ) is that of
the stresses that balanced all forces. The law as it is now may give others: a cache chooses at the
end of a load step which points RVEs answer in the next one, and a table learns from the audits.

What is wanted, a displacement or a force, is linear in Δf: δq = Σ_e w·Δf_e with a virtual
displacement w, which is −K⁻ᵀ a for a displacement a·u, and e − K⁻ᵀ ∂q/∂u for a force whose part by
f is e·f. So a random sample of n of N elements gives δq = (N/n) Σ w·Δf_e, and its standard
deviation an interval.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import SimulationError
from surrofe2.law.bifurcation import beyond_bifurcation
from surrofe2.law.stress_law import SURROGATE, TABLE, StressResponse
from surrofe2.macro.elements import deformation_gradient, internal_force, stress_power
from surrofe2.macro.equations_of_motion import (
    EquationsOfMotion,
    Evaluation,
    NoStress,
    factorised,
)
from surrofe2.macro.history import Frames
from surrofe2.macro.rest import Rest, evaluation_at
from surrofe2.macro.system import System

# Elements of a sample, at least, where there are so many.
LEAST = 128
# Standard deviations on each side of an interval of 95 %.
_CONFIDENT = 1.96
# Points for which the true law is called at once.
_BATCH = 1024

# A function that computes the stresses of the true law (RVEs) at rest, from numbers (k,) of points
# and F (k, 2, 2) there.
TrueStress = Callable[[Index, Array], StressResponse]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerError:
    """The error of a rest, estimated by one Newton correction; the corrected answer is its own plus
    this.

    Attributes:
        elements: number of elements whose points were solved by the true law.
        of: number of all elements; where both are equal nothing is estimated from a sample.
        solved: number of points at which the true law was called.
        residual: largest entry of Δf, of the elements that were asked, µN.
        displacement: (n, 2) error of the displacement of nodes and bodies, µm; None of a sample.
        watched: (2,) error of the displacement of the first watched point, µm.
        watched_interval: (2,) half width of its interval of 95 % confidence, 0 where all elements
            were asked.
        forces: (k, 2) errors of the forces that `System.force_names` lists, µN.
        forces_interval: (k, 2) half widths of their intervals.
        stress: (n_points, 2, 2) error of the stress at ũ, µN/µm; 0 in elements that are not of the
            sample, where it is not known.
    """

    elements: int
    of: int
    solved: int
    residual: float
    displacement: Array | None
    watched: Array
    watched_interval: Array
    forces: Array
    forces_interval: Array
    stress: Array

    @property
    def largest(self) -> float | None:
        """Largest error of the displacement of a node or body, µm; None of a sample."""
        if self.displacement is None:
            return None
        return float(np.linalg.norm(self.displacement, axis=1).max())


def answer_error(
    rest: Rest,
    law: Any,
    true_stress: TrueStress,
    *,
    most: int | None = None,
    seed: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> AnswerError:
    """Estimate the error of a rest from stresses of the true law, at all elements or a sample.

    Args:
        law: law by which the rest was computed.
        most: points that the true law may be asked for; beyond them a random sample of elements is
            taken, at least `LEAST`; None: all.
        progress: called with the number of points that are solved, and of how many.

    Raises:
        SimulationError: the true law has no stress at a point of the rest, or K is singular.
    """
    equations, now = _evaluated(rest, law)
    space = equations.discretisation
    count = len(space.elements)
    is_unknown = _unknown(now)
    unknown = is_unknown.reshape(count, space.points_per_element)
    asked = np.arange(count)
    if most is not None and unknown.sum() > most:
        per_element = max(1.0, float(unknown.sum(axis=1).mean()))
        size = min(count, max(LEAST, int(most / per_element)))
        asked = np.sort(np.random.default_rng(seed).choice(count, size, replace=False))
    points = np.zeros_like(unknown)
    points[asked] = unknown[asked]
    # The true law has answered the other points just now, as it may not have in the load step.
    error = np.where(is_unknown[:, None, None], 0.0, now.response.stress - rest.stress)
    _ask(rest, np.flatnonzero(points), true_stress, error, progress)
    lost = internal_force(space, now.F, error, rest.system.n_rows)
    solve = factorised(rest.stiffness)
    if solve is None:
        raise SimulationError("the error of the answer: the stiffness is singular")
    fields = _virtual_displacements(equations, now, rest)
    estimates = np.array([_estimate(space, now.F, error, w, asked) for w in fields])
    displacement = None
    if len(asked) == count:
        displacement = np.zeros((rest.system.n_rows, 2))
        displacement.ravel()[rest.system.free] = -solve(rest.system.pick(lost))
    return AnswerError(
        elements=len(asked),
        of=count,
        solved=int(points.sum()),
        residual=float(abs(rest.system.pick(lost)).max(initial=0.0)),
        displacement=displacement,
        watched=estimates[:2, 0],
        watched_interval=estimates[:2, 1],
        forces=estimates[2:, 0].reshape(-1, 2),
        forces_interval=estimates[2:, 1].reshape(-1, 2),
        stress=error,
    )


def corrected(rest: Rest, law: Any, error: AnswerError) -> tuple[Rest, Frames]:
    """Return the rest after the correction, and its whole fields: displacements, stresses and
    forces of its last load step; works are left as they were.

    Raises:
        ValueError: the error is that of a sample.
    """
    if error.displacement is None:
        raise ValueError("a sample of elements corrects no displacement")
    equations, now = _evaluated(rest, law)
    space = equations.discretisation
    system = rest.system
    u = rest.u + error.displacement
    F, F_dot, _ = deformation_gradient(space, system.from_mesh(u), np.zeros_like(u))
    assert now.response.tangents is not None
    slopes, _ = now.response.tangents.cauchy(now.F, now.response.stress)
    stress = rest.stress + error.stress
    stress += np.einsum("nabcd,ncd->nab", slopes, F - now.F)
    moved = now._replace(u=u, F=F, F_dot=F_dot, response=replace(now.response, stress=stress))
    columns = rest.columns
    row = rest.journal["rows"][-1].copy()
    bodies = error.displacement[len(space.nodes) :]
    changes = {
        **_changes(system.probe_names, system.probes @ error.displacement),
        **_changes([f"force {name}" for name in system.force_names], error.forces),
        **_changes([f"position {contact.name}" for contact in system.contacts], bodies),
    }
    for k, name in enumerate(columns):
        row[k] += changes.get(name, 0.0)
    journal = rest.journal.copy()
    journal["rows"][-1] = row
    kept = replace(rest, u=u, F=F, stress=stress, journal=journal)
    sources = None if now.response.sources is None else now.response.sources()
    beyond = beyond_bifurcation(law, rest.law_state)
    return kept, Frames.of(space, moved, sources, beyond=beyond)


def _evaluated(rest: Rest, law: Any) -> tuple[EquationsOfMotion, Evaluation]:
    """Return the equations of a rest by a law, and their evaluation there.

    Raises:
        SimulationError: the law has no stress there any more.
    """
    equations = EquationsOfMotion(rest.system, law, clock="load factor {:.6g}")
    try:
        return equations, evaluation_at(equations, rest)
    except NoStress as failure:
        raise SimulationError(f"the error of the answer is not known: {failure}") from failure


def _changes(names: Any, vectors: Array) -> dict[str, float]:
    """Return the entries of vectors (k, 2) by name and axis."""
    changes = {}
    for name, vector in zip(names, vectors, strict=True):
        for i, axis in enumerate("xy"):
            changes[f"{name} {axis}"] = float(vector[i])
    return changes


def _unknown(now: Evaluation) -> Flags:
    """Return (n_points,) whether a point's stress is not the true law's own."""
    if now.response.sources is None:
        return np.ones(len(now.F), dtype=np.bool_)
    return np.isin(now.response.sources().source, (SURROGATE, TABLE))


def _ask(
    rest: Rest,
    points: Index,
    true_stress: TrueStress,
    error: Array,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Set the error (n_points, 2, 2) at these points: the true law's stress less that of the rest.

    Raises:
        SimulationError: the true law has no stress at one of them.
    """
    for begin in range(0, len(points), _BATCH):
        batch = points[begin : begin + _BATCH]
        answer = true_stress(batch, np.ascontiguousarray(rest.F[batch]))
        if answer.status.any():
            point = int(batch[np.flatnonzero(answer.status)[0]])
            raise SimulationError(
                f"the error of the answer is not known: at point {point} the RVE has no stress"
            )
        error[batch] = answer.stress - rest.stress[batch]
        if progress is not None:
            progress(begin + len(batch), len(points))


def _estimate(space: Any, F: Array, error: Array, w: Array, asked: Index) -> tuple[float, float]:
    """Estimate w·Δf over all elements from the sampled ones.

    Args:
        error: (n_points, 2, 2) error of the stress.
        w: (n, 2) virtual displacement.
        asked: numbers of the sampled elements.

    Returns:
        The sum, and the half width of its interval of 95 % confidence; 0 of all elements.
    """
    _, gradient, _ = deformation_gradient(space, np.zeros_like(w), w)
    parts = stress_power(space, F, gradient, error)[asked]
    count = len(space.elements)
    sampled = len(asked)
    total = count / sampled * float(parts.sum())
    if sampled == count:
        return total, 0.0
    # drawn without replacement, hence the last factor
    scatter = float(parts.std(ddof=1)) / np.sqrt(sampled) * np.sqrt(1.0 - sampled / count)
    return total, _CONFIDENT * count * scatter


def _virtual_displacements(
    equations: EquationsOfMotion, now: Evaluation, rest: Rest
) -> list[Array]:
    """Compute the virtual displacements w (n, 2) of all quantities that are estimated.

    They are of the watched displacement along x and y, then of the forces of supports, loads and
    bodies along x and y.
    """
    system: System = rest.system
    n_nodes = len(equations.discretisation.nodes)
    transposed = factorised(rest.stiffness.T.tocsc())
    if transposed is None:
        raise SimulationError("the error of the answer: the stiffness is singular")
    none = np.zeros((system.n_rows, 2))
    parts: list[tuple[Array, Array]] = []  # e, and ∂q/∂u of all rows
    for axis in range(2):
        slope = none.copy()
        slope[:, axis] = system.probes[0]
        parts.append((none, slope))
    for support in system.holding:
        for axis in range(2):
            e = none.copy()
            along_axis = support.unknowns[support.unknowns % 2 == axis]
            e.ravel()[along_axis] = 1.0
            parts.append((e, equations.stiffness_transposed_times(now, e)))
    for slopes in equations.slopes_of_each_force(now):
        for axis in range(2):
            e = none.copy()
            e[:n_nodes, axis] = 1.0
            # the slopes are of −l
            slope = none if slopes is None else -(slopes[0].T @ e.ravel()).reshape(-1, 2)
            parts.append((none, slope))
    fields = []
    for e, slope in parts:
        w = e.copy()
        w.ravel()[system.free] -= transposed(system.pick(slope))
        fields.append(w)
    return fields
