"""An audited law in a run or rest: whether what was recorded stands, and the closing audit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from surrofe2.base.clock import clock
from surrofe2.law.stress_law import AuditedLaw
from surrofe2.macro.equations_of_motion import EquationsOfMotion

State = TypeVar("State")


class Report(NamedTuple):
    """Report of an audited law on a run: `cache`, plain values for run.json, and its decisions on
    windows of steps; None of other laws."""

    cache: dict[str, Any] | None
    decisions: list[dict[str, Any]] | None


class RunAudits:
    """Asks the law of a run for its verdicts, if it is an audited one; of other laws nothing.

    It is made before the law is asked for the first time: from there on the law counts.

    Args:
        law_state: what the law had committed where the run resumes; None at its start.
        t: where that is, µs, or the factor of the load.
    """

    def __init__(self, equations: EquationsOfMotion, law_state: Any = None, t: float = 0.0) -> None:
        self._equations = equations
        law = equations.law
        self._law = law if isinstance(law, AuditedLaw) else None
        self._is_watching = False
        self._is_window_known = self._law is not None and self._law.begin_run(law_state, t)

    def watch(self, *, has_mark: bool) -> bool:
        """From here on the law is asked after every step whether what was recorded stands.

        Args:
            has_mark: whether the run resumes from a state with a mark.

        Returns:
            Whether the caller must mark where it stands: a window that the law knows from the state
            that the run resumes from carries on.
        """
        self._is_watching = self._law is not None and self._law.is_audited
        return self._is_watching and not (has_mark and self._is_window_known)

    def mark(self, t: float) -> None:
        """Let what was kept up to t stand."""
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
        """The state to go back to where the steps since the mark do not stand, else None.

        Args:
            t: where the run stands.
            keep: called where they stand, to mark the end of the last one.
            go_back: called where they do not, when the law is back at the mark; gives the state.
            final: no step follows, or none can.
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
        """Solve a batch of the law's closing audit, and report how many are done of how many;
        False: there is none, or it is complete."""
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
        """Return the report of the law on this run, or of a run that is not finished its
        history; and its decisions."""
        law = self._law
        if law is None:
            return Report(None, None)
        return Report(law.report() if finished else law.history(), law.decisions)
