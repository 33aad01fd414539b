"""The hinge between the scales, `StressLaw`: (F, Ḟ) in, Cauchy stress out, for all points at once.

Representative volume elements, surrogates, caches and analytic laws all implement `StressLaw`;
the macro scale knows nothing else of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.base.tensors import cofactor


class Status(IntEnum):
    """The reason why a point has no stress; 0 where it has one."""

    OK = 0
    NOT_CONVERGED = 1
    UNSTABLE = 2
    OUT_OF_RANGE = 3
    NOT_FINITE = 4
    NOT_TRUSTED = 6  # 5 is no longer used; stored files keep these numbers


_SENTENCES = {
    Status.OK: "the stress is valid",
    Status.NOT_CONVERGED: "the RVE solve did not converge; load in smaller steps or raise the "
    "iteration limit",
    Status.UNSTABLE: "the RVE equilibrium is unstable and no stable one was found below it; the "
    "deformation is beyond what this cell bears homogeneously",
    Status.OUT_OF_RANGE: "the deformation or its rate is outside the range of the surrogate's "
    "data; use the cached law or train on a wider range",
    Status.NOT_FINITE: "the stress came out as NaN or infinite",
    Status.NOT_TRUSTED: "the bound of the surrogate's error exceeds the stress tolerance; use the "
    "cached law, raise the tolerance or train on more data",
}


def describe(status: int | Index) -> str:
    """State in words what `StressResponse.status` says.

    Args:
        status: the code of one point, or (n,) those of all points.

    Returns:
        The sentence of one code; of an array a line per code that occurs, the most frequent
        first, with the number of points that have it. An empty array gives an empty text.

    Raises:
        ValueError: a code that is none of `Status`.

    Examples:
        >>> import numpy as np
        >>> from surrofe2 import Status, describe
        >>> describe(0)
        'the stress is valid'
        >>> status = np.array([0, 0, Status.NOT_FINITE])  # as `respond` returns it
        >>> print(describe(status))
        2 of 3 points: the stress is valid
        1 of 3 points: the stress came out as NaN or infinite
    """
    codes = np.atleast_1d(status)
    if np.ndim(status) == 0:
        return _SENTENCES[Status(int(codes[0]))]
    counted = Counter(codes.ravel().tolist())
    lines = []
    for code, count in counted.most_common():
        lines.append(f"{count} of {codes.size} points: {_SENTENCES[Status(code)]}")
    return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class Tangents:
    """Derivatives of the first Piola–Kirchhoff stress P = det F σ F⁻ᵀ at n points.

    Attributes:
        P_by_F: (n, 2, 2, 2, 2), [point, a, b, c, d] = ∂P_ab/∂F_cd, µN/µm.
        P_by_F_dot: (n, 2, 2, 2, 2), [point, a, b, c, d] = ∂P_ab/∂Ḟ_cd, µN µs/µm.
    """

    P_by_F: Array
    P_by_F_dot: Array

    def over_step(self, dt: float) -> Array:
        """Combine both derivatives into the slope of the stress by F at the end of a time step.

        Within a step of length dt the rate follows F, F_dot = (F − F_old)/dt, so dP/dF is
        ∂P/∂F + (1/dt) ∂P/∂Ḟ: (n, 2, 2, 2, 2), µN/µm.

        Args:
            dt: length of the step, µs; infinite for a rest.

        Raises:
            InputError: dt is not positive.
        """
        if not dt > 0.0:
            raise InputError(f"dt: {dt}; it must be positive, or infinite at rest")
        return self.P_by_F if dt == np.inf else self.P_by_F + self.P_by_F_dot / dt

    def cauchy(self, F: Array, stress: Array) -> tuple[Array, Array]:
        """Convert to derivatives of the Cauchy stress σ = P Fᵀ/det F, by the product rule (A13).

        Args:
            F: (n, 2, 2) deformation at which the tangents hold.
            stress: (n, 2, 2) Cauchy stress there.

        Returns:
            ∂σ/∂F and ∂σ/∂Ḟ, (n, 2, 2, 2, 2) each, µN/µm and µN µs/µm.
        """
        J = np.linalg.det(F)
        inverse = np.linalg.inv(F)
        P = J[:, None, None] * stress @ np.swapaxes(inverse, 1, 2)
        by_F = np.einsum("naecd,nbe->nabcd", self.P_by_F, F)
        by_F += np.einsum("nad,bc->nabcd", P, np.eye(2))
        by_F /= J[:, None, None, None, None]
        by_F -= np.einsum("nab,ndc->nabcd", stress, inverse)
        by_F_dot = np.einsum("naecd,nbe->nabcd", self.P_by_F_dot, F)
        return by_F, by_F_dot / J[:, None, None, None, None]


# Codes of `Sources.source`. Codes of `Status`, 0 and above, mean there that an RVE was solved, for
# that reason; so these are negative.
SURROGATE = -2
TABLE = -3


@dataclass(frozen=True, slots=True)
class Sources:
    """Parts of a law that the stress of n points came from.

    Attributes:
        source: (n,) `SURROGATE`, `TABLE`, or the code of `Status` for which an RVE was solved.
        risk: (n,) bound of the error over the error that is allowed there; 0 where an RVE was
            solved.
    """

    source: NDArray[np.int8]
    risk: Array


@dataclass(frozen=True, slots=True)
class StressResponse:
    """The answer of a stress law at n points.

    Attributes:
        stress: (n, 2, 2) Cauchy stress in µN/µm; NaN where `status` is not 0.
        status: (n,) int8 codes of `Status`.
        state: warm start (or history) for the next call; opaque to everyone but its law.
        effort: cost of the answer by name, e.g. ``{"rve_solves": 80, "hits": 0}``; summable.
        tangents: derivatives of the stress, where they were asked for.
        switched: (n,) int8, None from laws of one branch. Not 0 where the law computed this stress
            by another branch (by an RVE, where the step began with the surrogate). The step then
            mixes both branches and must be started again, see `SwitchingLaw`.
        left_bifurcation: (n,) whether the point left its branch at a bifurcation on its way: the
            stress is that of a stable equilibrium, but other paths may lead to another one. None:
            nowhere.
        reasons: more words on points without stress than those of `describe`, by number of a point.
            Some points have them, and the first one without stress does if any has.
        sources: a function that computes where the stress came from; None where all of it is the
            law's own.
    """

    stress: Array
    status: NDArray[np.int8]
    state: Any = None
    effort: Mapping[str, int] = field(default_factory=dict)
    tangents: Tangents | None = None
    switched: NDArray[np.int8] | None = None
    left_bifurcation: Flags | None = None
    reasons: Mapping[int, str] = field(default_factory=dict)
    sources: Callable[[], Sources] | None = None

    def first_piola(self, F: Array) -> Array:
        """Return the first Piola–Kirchhoff stress P = det F σ F⁻ᵀ, µN/µm: force per unloaded
        length.

        Args:
            F: (n, 2, 2) deformation for which the law was asked.

        Returns:
            (n, 2, 2).
        """
        return np.asarray(self.stress @ cofactor(F))

    def __repr__(self) -> str:
        count = len(self.status)
        lost = int((self.status != 0).sum())
        more = ", with tangents" if self.tangents is not None else ""
        more += f", {lost} without stress" if lost else ""
        return f"<StressResponse: {count} point{'s' * (count != 1)}{more}>"


def joined(parts: Sequence[tuple[Index, StressResponse]], state: Any) -> StressResponse:
    """Join responses at parts of the points into one response at all of them.

    Args:
        parts: indices of a part's points, and the response there; together they are 0 … n − 1.
        state: the state that the joined response carries.

    Efforts are summed. Arrays that some parts lack (None) are filled by `joined_values`.
    """
    effort = Counter[str]()
    reasons = dict[int, str]()
    for index, part in parts:
        effort.update(part.effort)
        reasons |= {int(index[k]): reason for k, reason in part.reasons.items()}
    makers: list[tuple[Index, Any]] = [(index, part.sources) for index, part in parts]
    all_know = all(sources for _, sources in makers)

    def joined_sources() -> Any:
        """Compute the sources of each part, only when they are asked for."""
        return joined_values([(index, sources()) for index, sources in makers])

    arrays = {
        name: joined_values([(index, getattr(part, name)) for index, part in parts])
        for name in ("stress", "status", "tangents", "switched", "left_bifurcation")
    }
    return StressResponse(
        state=state,
        effort=effort,
        reasons=reasons,
        sources=joined_sources if all_know else None,
        **arrays,
    )


def joined_values(parts: Sequence[tuple[Index, Any]]) -> Any:
    """Join values at parts of the points into values at all of them.

    Args:
        parts: indices of a part's points, and arrays (k, …) of values there, or `Tangents` or
            `Sources` of such arrays. Together the indices are 0 … n − 1.

    Returns:
        Arrays (n, …), 0 where a part has None; None if all parts have None.
    """
    known: Any = next((values for _, values in parts if values is not None), None)
    if known is None:
        return None
    if isinstance(known, Tangents | Sources):
        columns = []
        for item in fields(known):
            columns.append([(index, getattr(values, item.name)) for index, values in parts])
        return type(known)(*map(joined_values, columns))
    whole = np.zeros((sum(len(index) for index, _ in parts), *known.shape[1:]), known.dtype)
    for index, values in parts:
        if values is not None:
            whole[index] = values
    return whole


class StressLaw(Protocol):
    """A constitutive law σ(F, Ḟ) for tissue.

    `respond` is pure: asked twice, it gives the same answer. `state` is a warm start or a history
    that only the time loop commits, by `accept` at the end of a step that it accepts.
    """

    @property
    def density(self) -> float | Array:
        """Mass per reference area, ng/µm²: one for all points, or (n,)."""

    @property
    def has_tangents(self) -> bool:
        """True if `respond` gives tangents when asked."""

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """Compute the stress at n points.

        Args:
            F: (n, 2, 2) deformation gradient, det F > 0.
            F_dot: (n, 2, 2) its material rate, 1/µs.
            state: state that an earlier answer or acceptance for the same points carried, or None.
            tangents: whether the answer shall carry the derivatives of the stress.

        Raises:
            InputError: wrong shape, not finite, det F ≤ 0, or tangents of a law without.
        """

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Commit `response`, which was given at (F, F_dot), the end of an accepted step.

        Returns:
            The response by which the next step begins; most laws return `response` itself. It may
            differ from `response` in these fields:

            status: not 0 at a point whose answer the law rejects after all, because of a check that
                is too expensive for every iteration (stability of an RVE). Then the law has
                committed nothing, and the caller must discard the step.
            state: state that the next call of `respond` gets.
            stress: changed at points that begin the next step on another branch (of a cached law:
                by an RVE instead of the surrogate), or at another equilibrium.
            left_bifurcation: (n,) whether a point lost stability in this step and was moved to
                another equilibrium.
        """


@runtime_checkable
class LearningLaw(StressLaw, Protocol):
    """A law that an accepted step changes beyond its state: it counts, or learns from the answers.

    Its `accept` is `check`, followed by `commit` unless the check rejected a point. A caller that
    joins several laws can so check all of them before any of them changes.
    """

    def check(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Return `response` with the status of each point that the law rejects; change nothing."""

    def commit(self, F: Array, F_dot: Array, checked: StressResponse) -> StressResponse:
        """Count and learn from a checked response; return the one by which the next step begins."""


class SwitchingLaw(StressLaw, Protocol):
    """A law of several branches, which gives `StressResponse.switched`.

    Within a step a point may leave its branch (the surrogate) but not come back. The first answer
    that computes a point by another branch marks it `switched`. The stepper then calls
    `restart_step` for the start of the step, takes its state and stress, and repeats the step at
    the same length.
    """

    def restart_step(
        self, F: Array, F_dot: Array, response: StressResponse, switched: NDArray[np.int8]
    ) -> StressResponse:
        """Compute the start of the step again, with the points `switched` on their new branch.

        Args:
            F, F_dot: (n, 2, 2) at the start of the step.
            response: stress and status there, and the committed state.
            switched: (n,) not 0 at the points that change their branch.

        Returns:
            The response at the start of the step, by which it begins again.
        """


@runtime_checkable
class AuditedLaw(StressLaw, Protocol):
    """A law that learns only later how wrong its answers were, as a cached law does by audits.

    The stepper calls `mark` where a window of steps begins, and `verdict` after every accepted
    step. If the answers of a window were right enough, its steps stand and the next window begins.
    If not, the stepper goes back to the mark, by the state that `roll_back` returns, and makes them
    again. When the run is over, a closing audit samples all answers that stand. It decides nothing:
    it states how many of them are wrong at most.
    """

    def begin_run(self, state: Any, t: float = 0.0) -> bool:
        """Begin a run, or continue one; counts and audits are for this run alone.

        Args:
            state: the committed state where the run begins.
            t: time from which on answers are counted, µs.

        Returns:
            Whether `state` is the one that `state_from_arrays` returned last. Then the law resumes
            a run with its counts, and the window of steps in which it was interrupted is known.
        """

    @property
    def is_audited(self) -> bool:
        """True if the law ever gives a verdict; else it is run without windows and audits."""

    def mark(self, t: float, state: Any) -> None:
        """Let all steps up to t (µs) stand, and begin a window there.

        `state` is what was committed at t; None where the run resumes cold from there.
        """

    def verdict(self, *, final: bool = False) -> bool | None:
        """Return whether the steps since the mark stand; None: not known yet.

        With `final` no step follows, and the verdict must be given.
        """

    def roll_back(self, t: float) -> Any:
        """Return the state at the mark, to go back to; t (µs) is where the window failed."""

    @property
    def closing_progress(self) -> tuple[int, int]:
        """Two numbers: answers of the closing audit that are solved, and all that it takes."""

    def next_closing(self) -> Any:
        """Solve the next batch of the closing audit and return it; None where none is due. Pure."""

    def commit_closing(self, solved: Any) -> None:
        """Record the batch that `next_closing` returned."""

    def history(self) -> dict[str, Any] | None:
        """Return counts, audits and trust so far, as plain values for run.json; None: no report."""

    def report(self) -> dict[str, Any] | None:
        """Complete the audits, the closing one too, and return `history` at the end of a run."""

    @property
    def decisions(self) -> list[dict[str, Any]] | None:
        """The decisions on windows of steps in the order of time; None: the law decides nothing."""


@runtime_checkable
class ResumableLaw(StressLaw, Protocol):
    """A law with a state that checkpoints hold."""

    def state_to_arrays(self, state: Any) -> dict[str, NDArray]:
        """Return what the law must know to resume from the committed `state`."""

    def state_from_arrays(self, arrays: Mapping[str, NDArray]) -> Any:
        """Return the committed state for which `state_to_arrays` gave these arrays."""


def state_arrays(law: StressLaw, state: Any) -> dict[str, NDArray]:
    """Return what any law must know to resume from the committed `state`; empty without one."""
    if state is None or not isinstance(law, ResumableLaw):
        return {}
    return law.state_to_arrays(state)


def state_of(law: StressLaw, arrays: Mapping[str, NDArray]) -> Any:
    """Return the committed state whose `state_arrays` these are; None of a law that keeps none."""
    if not isinstance(law, ResumableLaw) or not arrays:
        return None
    return law.state_from_arrays(arrays)


def require_tangents(law: StressLaw, purpose: str = "tangents") -> None:
    """Raise an `InputError` that begins with the purpose, unless the law gives tangents."""
    if not law.has_tangents:
        raise InputError(
            f"{purpose}: {type(law).__name__} has no tangents; use RVEs (--law rve, solver "
            "direct) or integrator explicit"
        )


def check_deformation(F: Any, F_dot: Any) -> tuple[Array, Array]:
    """Check a deformation and its rate at n points.

    Returns:
        F and F_dot as contiguous float64 arrays (n, 2, 2).

    Raises:
        InputError: wrong shape, not real and finite numbers, or det F ≤ 0; the point is named.
    """
    F = _as_tensors("F", F)
    F_dot = _as_tensors("F_dot", F_dot)
    if F.shape != F_dot.shape:
        raise InputError(
            f"F_dot: shape {F_dot.shape} does not match the shape {F.shape} of F; "
            "both must be (n, 2, 2)"
        )
    det = F[:, 0, 0] * F[:, 1, 1] - F[:, 0, 1] * F[:, 1, 0]
    if det.size and det.min() <= 0.0:
        point = int(det.argmin())
        raise InputError(f"F: det F = {det[point]:.6g} at point {point}; it must be positive")
    return F, F_dot


def _as_tensors(name: str, value: Any) -> Array:
    """Return a value as a contiguous float64 array (n, 2, 2), or raise an error with this name."""
    try:
        tensors = np.asanyarray(value)
    except (TypeError, ValueError):
        tensors = np.array(None)  # ragged lists make no array; this one is rejected below
    # floating point, signed and unsigned integers
    if tensors.dtype.kind not in "fiu":
        raise InputError(f"{name}: {tensors.dtype}; it must be an array (n, 2, 2) of real numbers")
    if np.ma.isMaskedArray(tensors):
        raise InputError(f"{name}: a masked array; every entry must be a number")
    array = np.ascontiguousarray(tensors, dtype=np.float64)
    if array.ndim != 3 or array.shape[1:] != (2, 2):
        raise InputError(f"{name}: shape {np.shape(value)}; it must be (n, 2, 2)")
    if not np.isfinite(array).all():
        point = int(np.argwhere(~np.isfinite(array))[0, 0])
        raise InputError(f"{name}: not finite at point {point}; every entry must be a number")
    return array
