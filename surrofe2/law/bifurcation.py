"""Points beyond a bifurcation, where plant cells have buckled, and laws that know them."""

from __future__ import annotations

from typing import Any, Protocol, cast

from surrofe2.base.arrays import Flags
from surrofe2.law.stress_law import StressLaw


class BranchingLaw(StressLaw, Protocol):
    """A law that knows which of its points are beyond a bifurcation."""

    def beyond_bifurcation(self, state: Any) -> Flags | None:
        """Return (n,) whether each point has left its branch at a bifurcation, up to `state`.

        Its stress is then that of a stable equilibrium, but other paths may lead to another one.
        None: the law does not know.
        """


def beyond_bifurcation(law: StressLaw, state: Any) -> Flags | None:
    """Return (n,) which points of a law are beyond a bifurcation, see `BranchingLaw`.

    None of other laws, and where nothing was committed yet.
    """
    if state is None or not is_branching(law):
        return None
    return cast(BranchingLaw, law).beyond_bifurcation(state)


def is_branching(law: StressLaw) -> bool:
    """Return whether a law is a `BranchingLaw`.

    isinstance would compute all properties that such a law has, as the density of its plant cell,
    which takes as long as a step.
    """
    return hasattr(law, "beyond_bifurcation")


def count_beyond(law: StressLaw, state: Any) -> float:
    """Count the points beyond a bifurcation; NaN where the law does not know."""
    flags = beyond_bifurcation(law, state)
    return float("nan") if flags is None else float(flags.sum())
