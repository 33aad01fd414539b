"""Item 3: `direct` against the paper's iteration on the questions of one and the same bar run.

Both are asked what a true run asked, in its order, each with the state of its own last answer
(`iterated` carries velocities along, v ← v + L'x' − Lx), block by block in turns, on one thread.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.row import Row
from benchmarks.setting import Array, Setting, rve
from benchmarks.timing import threads, time_calls
from benchmarks.watched_law import Asked, RecordingLaw
from surrofe2 import LoadCase, MacroSettings, RveLaw, simulate

TITLE = "Against the paper's scheme (preset printed)"
PRESET = "printed"
BLOCK = 20
"""Questions that one solver answers before it is the other's turn."""
EXACT = 1e-11
"""Mean force in µN at which an answer counts as exact."""
_ERROR = "largest |Δσ| / largest |σ| of the run against an answer at 1e-11 µN"


@dataclass
class Replay:
    """A law answering recorded questions in order; `kept` answers are those of every stride-th."""

    law: RveLaw
    stride: int
    state: Any = None
    asked: int = 0
    seconds: list[float] = field(default_factory=list)
    evaluations: int = 0
    kept: list[Array] = field(default_factory=list)

    def answer(self, questions: list[Asked]) -> None:
        """Answer a block, on the clock."""
        begin = perf_counter()
        answers = []
        for question in questions:
            answer = self.law.respond(question.F, question.F_dot, self.state)
            self.state = answer.state
            if question.accepted:
                self.state = self.law.accept(question.F, question.F_dot, answer).state
            answers.append(answer)
        self.seconds.append(perf_counter() - begin)
        for answer in answers:
            if self.asked % self.stride == 0:
                self.kept.append(answer.stress)
            self.asked += 1
            self.evaluations += answer.effort["force_evaluations"]


def run(setting: Setting) -> list[Row]:
    """At the paper's loose stop along the run, then at equal residual on a sample of it."""
    duration = setting.pick(250.0, 10.0)
    with threads(1):
        questions = record(duration)
        return [_loose(setting, questions, duration), _equal(setting, questions)]


def record(duration: float) -> list[Asked]:
    """What a true run of the bar asks."""
    law = RecordingLaw(rve(PRESET))
    simulate(LoadCase(duration=duration), law, MacroSettings(record_dissipation=False))
    return law.asked


def _loose(setting: Setting, questions: list[Asked], duration: float) -> Row:
    stride = setting.pick(50, 10)
    direct = Replay(rve(PRESET), stride)
    iterated = Replay(rve(PRESET, solver="iterated"), stride)
    _warm_up(direct.law, iterated.law, questions)
    for start in range(0, len(questions), BLOCK):
        for replay in (direct, iterated):
            replay.answer(questions[start : start + BLOCK])
    exact = [_exact(question) for question in questions[::stride]]
    solves = len(questions) * len(questions[0].F)
    per_solve = 1e6 / solves
    quotients = np.divide(iterated.seconds, direct.seconds)
    low, high = np.percentile(quotients, (25, 75))
    return Row(
        name=f"direct at 1e-8 along the bar over {duration:g} µs, times faster than the paper's "
        "iteration at its loose stop of 1.0",
        value=sum(iterated.seconds) / sum(direct.seconds),
        spread=float(high - low),
        unit="×",
        limit=2.0,
        at_least=True,
        baseline="iterated at 1.0",
        error=_error(direct.kept, exact),
        baseline_error=_error(iterated.kept, exact),
        error_of=_ERROR,
        note=f"{sum(direct.seconds) * per_solve:.3g} against "
        f"{sum(iterated.seconds) * per_solve:.3g} µs and {direct.evaluations / solves:.3g} "
        f"against {iterated.evaluations / solves:.3g} force evaluations a solve",
    )


def _equal(setting: Setting, questions: list[Asked]) -> Row:
    """Both to 1e-8, from the exact state of the question before."""
    direct, iterated = rve(PRESET), rve(PRESET, solver="iterated", stop=1e-8)
    count = setting.pick(6, 1)
    chosen = np.linspace(0.2, 0.9, count) * (len(questions) - 1)
    times, errors, scale, evaluations = np.zeros((2, count)), np.zeros((2, count)), 0.0, [0, 0]
    for k, index in enumerate(chosen.astype(int)):
        before, here = questions[index - 1], questions[index]
        start = direct.respond(before.F, before.F_dot).state
        # The same particles, as a state of the other law.
        others = replace(start, of=iterated.rest_state(start.points).of)
        exact = _exact(here)
        scale = max(scale, float(abs(exact).max()))
        times[0, k] = time_calls(lambda: direct.respond(here.F, here.F_dot, start), 5).median  # noqa: B023
        begin = perf_counter()
        slow = iterated.respond(here.F, here.F_dot, others)
        times[1, k] = perf_counter() - begin
        for side, answer in enumerate((direct.respond(here.F, here.F_dot, start), slow)):
            errors[side, k] = abs(answer.stress - exact).max()
            evaluations[side] += answer.effort["force_evaluations"]
    points = count * len(questions[0].F)
    micro = 1e6 / points * times.sum(axis=1)
    return Row(
        name=f"direct at 1e-8, times faster than the paper's iteration at 1e-8 ({count} questions "
        "of the run, both from the exact state before)",
        value=float(np.median(times[1] / times[0])),
        spread=float(np.subtract(*np.percentile(times[1] / times[0], (75, 25)))),
        unit="×",
        limit=1000.0,
        at_least=True,
        baseline="iterated at 1e-8",
        error=errors[0].max() / scale,
        baseline_error=errors[1].max() / scale,
        error_of=_ERROR,
        note=f"{micro[0]:.3g} against {micro[1]:.3g} µs and {evaluations[0] / points:.3g} against "
        f"{evaluations[1] / points:.3g} force evaluations a solve",
    )


def _warm_up(direct: RveLaw, iterated: RveLaw, questions: list[Asked]) -> None:
    first = questions[0]
    for law in (direct, iterated):
        answer = law.respond(first.F, first.F_dot)
        law.respond(first.F, first.F_dot, law.accept(first.F, first.F_dot, answer).state)


def _exact(question: Asked) -> Array:
    answer = rve(PRESET, tolerance=EXACT).respond(question.F, question.F_dot)
    if answer.status.any():
        raise RuntimeError(f"no exact answer: {int((answer.status != 0).sum())} points failed")
    return answer.stress


def _error(answers: list[Array], exact: list[Array]) -> float:
    scale = max(abs(stress).max() for stress in exact)
    return float(max(abs(a - e).max() for a, e in zip(answers, exact, strict=True)) / scale)
