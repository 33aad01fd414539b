"""A dry run of a recipe's problem: how often a run asks its law, and windows of what it asks.

The law is the quadratic one of the RVEs at rest, whose steps are those of a true run within a few
per cent. The windows, asked again of another law, say what that costs along the run.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError, SimulationError
from surrofe2.macro import simulate
from surrofe2.recipe import Recipe
from surrofe2.stress_law import Acceptance, StressLaw, StressResponse
from surrofe2.workflow.cell_laws import law_by_region
from surrofe2.workflow.laws import quadratic_law
from surrofe2.workflow.run_lifecycle import Report, untold

Array = NDArray[np.float64]

WINDOWS, STEPS, WARM = 5, 10, 4
"""Windows along a run, the steps in each, and how many of these only warm up: a run's factors of
RVEs are some steps old."""
_COARSEST = 4


@dataclass(frozen=True, slots=True)
class Asked:
    """A question for (n, 2, 2) each; whether for tangents too, and whether it ends a step."""

    F: Array
    F_dot: Array
    tangents: bool
    ends_step: bool


Window = list[Asked]


@dataclass(frozen=True, slots=True, kw_only=True)
class DryRun:
    """What a run asks of its law.

    Attributes:
        points: asked at once.
        calls, steps: of the whole run; extrapolated where the dry run did not come to its end.
        macro: seconds outside the law a call.
        windows: what was asked in a few places along the run, by as many points as there are.
        is_whole: whether it came to its end.
    """

    points: int
    calls: float
    steps: float
    macro: float
    windows: list[Window]
    is_whole: bool


class _Enough(Exception):  # noqa: N818 - no error
    """The seconds of a dry run are spent."""


@dataclass
class _Recorder:
    """The law of a dry run, which notes what it is asked."""

    law: StressLaw
    calls: int = 0
    steps: int = 0
    seconds: float = 0.0
    begun: float = 0.0
    wanted: int = STEPS
    windows: list[Window] = field(default_factory=lambda: [[]])

    def __post_init__(self) -> None:
        self.density, self.has_tangents = self.law.density, self.law.has_tangents

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """The law's answer."""
        start = perf_counter()
        self.begun = self.begun or start
        self.calls += 1
        answer = self.law.respond(F, F_dot, state, tangents=tangents)
        if self.wanted:
            self.windows[-1].append(Asked(F.copy(), F_dot.copy(), tangents, False))
        self.seconds += perf_counter() - start
        return answer

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """The law's acceptance."""
        self.steps += 1
        if self.wanted and self.windows[-1]:
            self.windows[-1][-1] = replace(self.windows[-1][-1], ends_step=True)
            self.wanted -= 1
        return self.law.accept(F, F_dot, response)

    def begin_window(self) -> None:
        """Note the next steps."""
        if self.windows[-1]:
            self.windows.append([])
        self.wanted = STEPS

    @property
    def macro(self) -> float:
        """Seconds outside the law a call."""
        return max(0.0, perf_counter() - self.begun - self.seconds) / max(self.calls, 1)


def dry_run(recipe: Recipe, seconds: float, report: Report = untold) -> DryRun:
    """A dry run of a recipe's problem of so many seconds at most.

    Where that is not enough, steps and calls go on as in the second half of it, and the windows are
    those of a coarser mesh, if the recipe's is a rectangle.

    Args:
        report: is told the time reached in µs.

    Raises:
        SimulationError: the run could not be carried on.
    """
    found = _tried(recipe, seconds, report)
    windows, whole, coarse = found.windows, found.is_whole, coarser(recipe)
    while not whole and coarse is not None:
        other = _tried(coarse, seconds, report)
        windows, whole, coarse = other.windows, other.is_whole, coarser(coarse)
    return replace(found, windows=windows)


def coarser(recipe: Recipe) -> Recipe | None:
    """The recipe on a quarter of the elements; None where the mesh is no rectangle to be halved."""
    stated = recipe.stated
    elements = recipe.macro.elements if stated is None else stated.mesh.elements
    if elements is None or recipe.types or max(elements) <= _COARSEST:
        return None
    fewer = (max(1, elements[0] // 2), max(1, elements[1] // 2))
    if stated is None:
        return replace(recipe, macro=replace(recipe.macro, elements=fewer))
    other = replace(recipe, stated=replace(stated, mesh=replace(stated.mesh, elements=fewer)))
    try:
        other.problem()
    except InputError:  # it names what a coarser mesh has not
        return None
    return other


def _tried(recipe: Recipe, seconds: float, report: Report) -> DryRun:
    problem, duration = recipe.problem(), recipe.duration
    law = _Recorder(law_by_region(recipe, problem.mesh, quadratic_law))
    settings = replace(recipe.macro, frames=2)
    marks: list[tuple[float, int, int]] = []
    until = perf_counter() + seconds

    def progress(t: float, of: float) -> None:
        report(t, "")
        marks.append((t, law.calls, law.steps))
        if t >= duration * len(law.windows) / WINDOWS and not law.wanted:
            law.begin_window()
        if perf_counter() > until:
            raise _Enough

    try:
        with recipe.named(InputError):
            simulate(problem, law, settings, progress=progress)
    except _Enough:
        pass
    except SimulationError as error:
        raise SimulationError(f"check: the dry run by the quadratic law: {error}") from error
    (t, calls, steps), (then, before, earlier) = marks[-1], marks[len(marks) // 2]
    left = (duration - t) / (t - then) if t > then else 0.0
    return DryRun(
        points=len(law.windows[0][0].F),
        calls=calls + left * (calls - before),
        steps=steps + left * (steps - earlier),
        macro=law.macro,
        windows=_fullest(law.windows),
        is_whole=t >= duration,
    )


def _steps_in(window: Window) -> int:
    return sum(each.ends_step for each in window)


def _fullest(windows: list[Window]) -> list[Window]:
    """Those with steps to time behind the warm ones; of a short run the longest."""
    full = [window for window in windows if _steps_in(window) > WARM]
    return full or [max(windows, key=_steps_in)]


def replayed(law: StressLaw, window: Window, rows: NDArray[np.intp]) -> tuple[float, int, Any]:
    """Seconds and number of the questions of a window behind its first steps, and the state left.

    Args:
        rows: points of the window that are asked.
    """
    state, seconds, asked, steps = None, 0.0, 0, 0
    warm = min(WARM, _steps_in(window) - 1)
    for each in window:
        F, F_dot = each.F[rows], each.F_dot[rows]
        start = perf_counter()
        answer = law.respond(F, F_dot, state, tangents=each.tangents)
        if answer.switched is not None:
            # a stepper would begin the step anew; here the points stay where they came to
            answer = replace(answer, switched=None)
        if each.ends_step:
            state = law.accept(F, F_dot, answer).state
        if steps >= warm:
            seconds, asked = seconds + perf_counter() - start, asked + 1
        steps += each.ends_step
    return seconds, asked, state


def seconds_a_call(
    law: StressLaw, windows: list[Window], rows: NDArray[np.intp], seconds: float
) -> tuple[float, Any]:
    """Seconds of a question for these points, mean of windows, and the last state.

    Args:
        seconds: after so many no further window is begun; the middle of the run comes first.
    """
    order = sorted(range(len(windows)), key=lambda k: abs(k - len(windows) // 2))
    replayed(law, windows[order[0]], rows)  # loads kernels
    total, count, state, until = 0.0, 0, None, perf_counter() + seconds
    for k in order:
        taken, asked, state = replayed(law, windows[k], rows)
        total, count = total + taken, count + asked
        if perf_counter() > until:
            break
    return total / max(count, 1), state
