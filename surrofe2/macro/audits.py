"""An audited law in a run or rest: its verdicts on what was recorded, and its closing audit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from surrofe2.base.clock import clock
from surrofe2.law.stress_law import AuditedLaw
from surrofe2.macro.equations_of_motion import EquationsOfMotion

State = TypeVar("State")


class Report(NamedTuple):
    """The report of an audited law on a run; both are None of other laws.

    Attributes:
        cache: plain values for run.json.
        decisions: its decisions on windows of steps.
    """

    cache: dict[str, Any] | None
    decisions: list[dict[str, Any]] | None


class RunAudits:
    """The audits of a run: asks its law for verdicts, if that is an `AuditedLaw`.

    It must be made before the law is called for the first time, since the law counts from there on.

    Args:
        equations: equations of the run, with the law.
        law_state: state that the law had committed where the run resumes; None at its start.
        t: time at which it resumes, µs, or the factor of the load.
    """

    def __init__(self, equations: EquationsOfMotion, law_state: Any = None, t: float = 0.0) -> None:
        self._equations = equations
        law = equations.law
        self._law = law if isinstance(law, AuditedLaw) else None
        self._is_watching = False
        self._is_window_known = self._law is not None and self._law.begin_run(law_state, t)

    def watch(self, *, has_mark: bool) -> bool:
        """Begin to ask the law after every step whether what was recorded stands.

        Args:
            has_mark: whether the run resumes from a state with a mark.

        Returns:
            Whether the caller must mark where it stands. It need not where it resumes within a
            window that the law knows from its state.
        """
        self._is_watching = self._law is not None and self._law.is_audited
        return self._is_watching and not (has_mark and self._is_window_known)

    def mark(self, t: float) -> None:
        """Let what was recorded up to t stand, and begin a window there."""
        assert self._law is not None
        self._law.mark(t, self._equations.law_state)

    def settle(
        self,
        t: float,
        keep: Callable[[], None],
        go_back: Callable[[], State],
        *,
        final: bool = False,
    ) -> State | None:
        """Ask the law for its verdict, and return the state to go back to, if any.

        Args:
            t: time that the run has reached, µs, or the factor of the load.
            keep: called where the steps since the mark stand, to mark the end of the last one.
            go_back: called where they do not, when the law is back at the mark; returns the state.
            final: no step follows, or none can.

        Returns:
            The state to go back to; None where the steps stand, or there is no verdict yet.
        """
        equations = self._equations
        back = None
        if self._is_watching and self._law is not None:
            equations.is_committing = True
            stands = self._law.verdict(final=final)
            if stands:
                keep()
            elif stands is not None:
                equations.law_state = self._law.roll_back(t)
                back = go_back()
        equations.is_committing = False
        return back

    def close(self, closing: Callable[[int, int], None] | None) -> bool:
        """Solve a batch of the law's closing audit.

        Args:
            closing: called then with the number of answers that are solved, and of all.

        Returns:
            Whether there was a batch; False: there is no closing audit, or it is complete.
        """
        law = self._law
        equations = self._equations
        if law is None:
            return False
        began = clock()
        solved = law.next_closing()  # pure: an interrupt leaves the batch to the resumed run
        if solved is not None:
            equations.is_committing = True
            law.commit_closing(solved)
            equations.is_committing = False
        equations.tally.law_seconds += clock() - began
        if solved is not None and closing is not None:
            closing(*law.closing_progress)
        return solved is not None

    def report(self, *, finished: bool) -> Report:
        """Return the law's report on a finished run, or its history of an unfinished one; and
        its decisions.
        """
        law = self._law
        if law is None:
            return Report(None, None)
        return Report(law.report() if finished else law.history(), law.decisions)
