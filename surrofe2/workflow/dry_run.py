"""A dry run of a recipe's problem: how often a run asks its law, and windows of what it asks.

The law is the quadratic one of the RVEs at rest, whose steps are those of a true run within a few
per cent. The windows, asked again of another law, say what that costs along the run; the path
says what a law that learns must learn.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import clock
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
_PATH, _SHORTEST, _PATH_STATES = 128, 16, 1 << 17
"""Steps of the path along a run, and half as many at least; fewer of very many points that must
all be there; and its states of points."""


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
        path: evenly some of the steps, from the first on, and of the points.
        is_whole: whether it came to its end.
        times, calls_until: µs, and how often the law was asked until then; from start to end.
    """

    points: int
    calls: float
    steps: float
    macro: float
    windows: list[Window]
    path: Window
    is_whole: bool
    times: Array
    calls_until: Array

    def share(self, t: float) -> float:
        """Of all calls, those until a time in µs."""
        return float(np.interp(t, self.times, self.calls_until)) / self.calls


class _Enough(Exception):  # noqa: N818 - no error
    """The seconds of a dry run are spent."""


@dataclass
class _Recorder:
    """The law of a dry run, which notes what it is asked.

    Attributes:
        takes_all: whether the path must be of all points.
    """

    law: StressLaw
    calls: int = 0
    steps: int = 0
    seconds: float = 0.0
    begun: float = 0.0
    wanted: int = STEPS
    windows: list[Window] = field(default_factory=lambda: [[]])
    path: Window = field(default_factory=list)
    stride: int = 1
    takes_all: bool = False

    def __post_init__(self) -> None:
        self.density, self.has_tangents = self.law.density, self.law.has_tangents

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """The law's answer."""
        start = clock()
        self.begun = self.begun or start
        self.calls += 1
        answer = self.law.respond(F, F_dot, state, tangents=tangents)
        if self.wanted:
            self.windows[-1].append(Asked(F.copy(), F_dot.copy(), tangents, False))
        self.seconds += clock() - start
        return answer

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """The law's acceptance."""
        if self.steps % self.stride == 0:
            self._go_on(F, F_dot)
        self.steps += 1
        if self.wanted and self.windows[-1]:
            self.windows[-1][-1] = replace(self.windows[-1][-1], ends_step=True)
            self.wanted -= 1
        return self.law.accept(F, F_dot, response)

    def _go_on(self, F: Array, F_dot: Array) -> None:
        """The path by one step; every other one goes where there are too many."""
        rows = evenly(len(F), len(F) if self.takes_all else _PATH_STATES // _PATH)
        self.path.append(Asked(F[rows], F_dot[rows], False, True))
        if len(self.path) > max(_SHORTEST, min(_PATH, _PATH_STATES // len(rows))):
            self.path, self.stride = self.path[::2], 2 * self.stride

    def begin_window(self) -> None:
        """Note the next steps."""
        if self.windows[-1]:
            self.windows.append([])
        self.wanted = STEPS

    @property
    def macro(self) -> float:
        """Seconds outside the law a call."""
        return max(0.0, clock() - self.begun - self.seconds) / max(self.calls, 1)


def dry_run(recipe: Recipe, seconds: float, report: Report = untold) -> DryRun:
    """A dry run of a recipe's problem of so many seconds at most.

    Where that is not enough, steps and calls go on as in the second half of it, and windows and
    path are those of a coarser mesh, if the recipe's is a rectangle.

    Args:
        report: is told the time reached in µs.

    Raises:
        SimulationError: the run could not be carried on.
    """
    found = _tried(recipe, seconds, report)
    best, coarse = found, coarser(recipe)
    while not best.is_whole and coarse is not None:
        best, coarse = _tried(coarse, seconds, report), coarser(coarse)
    return replace(found, windows=best.windows, path=best.path)


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
    duration, mesh = recipe.duration, recipe.problem().mesh
    law = _Recorder(law_by_region(recipe, mesh, quadratic_law), takes_all=bool(recipe.types))
    marks = [(0.0, 0, 0)]

    def mark(t: float) -> None:
        report(t, "")
        marks.append((t, law.calls, law.steps))
        if t >= duration * len(law.windows) / WINDOWS and not law.wanted:
            law.begin_window()

    try:
        _simulated(recipe, law, seconds, mark)
    except SimulationError as error:
        raise SimulationError(f"check: the dry run by the quadratic law: {error}") from error
    (t, calls, steps), (then, before, earlier) = marks[-1], marks[(len(marks) - 1) // 2]
    left = (duration - t) / (t - then) if t > then else 0.0
    all_calls = calls + left * (calls - before)
    return DryRun(
        points=len(law.windows[0][0].F),
        calls=all_calls,
        steps=steps + left * (steps - earlier),
        macro=law.macro,
        windows=_fullest(law.windows),
        path=law.path,
        is_whole=t >= duration,
        times=np.array([*(time for time, _, _ in marks), duration]),
        calls_until=np.array([*(asked for _, asked, _ in marks), all_calls]),
    )


def _simulated(
    recipe: Recipe, law: StressLaw, seconds: float, mark: Callable[[float], None]
) -> None:
    """Simulate a recipe's problem for so many seconds at most, with the time told in µs."""
    until = clock() + seconds

    def progress(t: float, of: float) -> None:
        mark(t)
        if clock() > until:
            raise _Enough

    with suppress(_Enough), recipe.named(InputError):
        simulate(recipe.problem(), law, replace(recipe.macro, frames=2), progress=progress)


def timed_run(recipe: Recipe, law: StressLaw, seconds: float, run: DryRun) -> tuple[float, bool]:
    """Seconds of a run by this law, and whether it came to its end in so many; else each call that
    the dry run has left takes as long as those of the second half.

    Raises:
        SimulationError: the run could not be carried on.
    """
    began = clock()
    marks = [(0.0, 0.0)]
    _simulated(recipe, law, seconds, lambda t: marks.append((t, clock() - began)))
    (t, taken), (then, before) = marks[-1], marks[(len(marks) - 1) // 2]
    done, earlier = run.share(t), run.share(then)
    left = (1.0 - done) / (done - earlier) if done > earlier else 0.0
    return taken + left * (taken - before), t >= recipe.duration


def evenly(count: int, most: int) -> NDArray[np.intp]:
    """So many indices below `count` at most, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))


def _steps_in(window: Window) -> int:
    return sum(each.ends_step for each in window)


def _fullest(windows: list[Window]) -> list[Window]:
    """Those with steps to time behind the warm ones; of a short run the longest."""
    full = [window for window in windows if _steps_in(window) > WARM]
    return full or [max(windows, key=_steps_in)]


def replayed(
    law: StressLaw, window: Window, rows: NDArray[np.intp], warm: int = WARM
) -> tuple[float, int, Any]:
    """Seconds and number of the questions of a window behind its first steps, and the state left.

    Args:
        rows: points of the window that are asked.
        warm: steps that are not counted, if there are more.
    """
    state, seconds, asked, steps = None, 0.0, 0, 0
    warm = min(warm, _steps_in(window) - 1)
    for each in window:
        F, F_dot = each.F[rows], each.F_dot[rows]
        start = clock()
        answer = law.respond(F, F_dot, state, tangents=each.tangents)
        if answer.switched is not None:
            # a stepper would begin the step anew; here the points stay where they came to
            answer = replace(answer, switched=None)
        if each.ends_step:
            state = law.accept(F, F_dot, answer).state
        if steps >= warm:
            seconds, asked = seconds + clock() - start, asked + 1
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
    total, count, state, until = 0.0, 0, None, clock() + seconds
    for k in order:
        taken, asked, state = replayed(law, windows[k], rows)
        total, count = total + taken, count + asked
        if clock() > until:
            break
    return total / max(count, 1), state
