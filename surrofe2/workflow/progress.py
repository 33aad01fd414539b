"""How work reports what it does: it begins stages, and each says how far it is."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

Report = Callable[[float, str], None]
"""Called with how much is done and a remark."""
Stage = Callable[[str, float, str], AbstractContextManager[Report]]
"""Begins to display a stage: what is done, how much of it, in which unit."""


def no_report(done: float, note: str = "") -> None:
    """A report that displays nothing."""


def no_stage(what: str, total: float, unit: str) -> AbstractContextManager[Report]:
    """A stage that displays nothing."""
    return nullcontext(no_report)
