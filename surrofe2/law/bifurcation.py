"""Which points of a law are beyond a bifurcation: where plant cells have buckled."""

from __future__ import annotations

from typing import Any, Protocol, cast

from surrofe2.base.arrays import Flags
from surrofe2.law.stress_law import StressLaw


class BranchingLaw(StressLaw, Protocol):
    """A law that knows which of its points are beyond a bifurcation."""

    def beyond_bifurcation(self, state: Any) -> Flags | None:
        """(n,) whether each point left its branch at a bifurcation on the way to a committed
        `state`: its stress is that of a stable equilibrium, but other ways may lead to another one.
        None: the law cannot tell."""


def beyond_bifurcation(law: StressLaw, state: Any) -> Flags | None:
    """As of `BranchingLaw`; None of other laws, and where nothing was committed yet."""
    if state is None or not is_branching(law):
        return None
    return cast(BranchingLaw, law).beyond_bifurcation(state)


def is_branching(law: StressLaw) -> bool:
    """Whether it is a `BranchingLaw`; isinstance would compute all that such a law has, as the
    density of its plant cell, which takes as long as a step."""
    return hasattr(law, "beyond_bifurcation")


def count_beyond(law: StressLaw, state: Any) -> float:
    """Return how many points are beyond a bifurcation; NaN where the law cannot tell."""
    flags = beyond_bifurcation(law, state)
    return float("nan") if flags is None else float(flags.sum())
