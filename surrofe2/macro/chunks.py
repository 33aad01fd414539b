"""Chunks of steps that an audited law lets stand, or that are made again."""

from __future__ import annotations

from surrofe2.law.stress_law import AuditedLaw
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.history import MacroState, Recorder


class Chunks:
    """Asks the law of a run after every step whether what was recorded stands.

    Args:
        resume: that the run goes on from; its chunk goes on too where the law knows of it.
    """

    def __init__(
        self, equations: EquationsOfMotion, recorder: Recorder, resume: MacroState | None
    ) -> None:
        law = equations.law
        self._law = law if isinstance(law, AuditedLaw) and law.is_audited else None
        self._equations, self._recorder = equations, recorder
        known = resume is not None and resume.mark is not None and resume.law_state is not None
        if self._law is not None and not known:
            self._mark(self._law)

    def settle(self, *, final: bool = False) -> MacroState | None:
        """The state to go back to where the steps since the mark do not stand, else None.

        final: no step follows, or none can.
        """
        back, equations = None, self._equations
        if self._law is not None:
            equations.is_committing = True
            stands, t = self._law.verdict(final=final), self._recorder.t
            if stands:
                self._mark(self._law)
            elif stands is not None:
                equations.law_state = self._law.roll_back(t)
                back = self._recorder.go_back()
        equations.is_committing = False
        return back

    def _mark(self, law: AuditedLaw) -> None:
        law.mark(self._recorder.t, self._equations.law_state)
        self._recorder.mark()
