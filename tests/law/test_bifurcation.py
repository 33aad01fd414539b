"""Which points of a law are beyond a bifurcation."""

import numpy as np

from surrofe2.law.bifurcation import beyond_bifurcation, count_beyond
from tests.laws import KelvinVoigt


class Branching:
    """A law that tells, and whose density takes long to compute."""

    @property
    def density(self):
        raise AssertionError("nobody needs it here")

    def beyond_bifurcation(self, state):
        return state


def test_a_law_is_asked_for_its_branches_alone():
    """Each frame asks; whether a law has all that its protocol says took as long as a step."""
    flags = np.array([True, False, True])
    assert beyond_bifurcation(Branching(), flags) is flags
    assert count_beyond(Branching(), flags) == 2.0
    assert beyond_bifurcation(Branching(), None) is None
    assert beyond_bifurcation(KelvinVoigt(), flags) is None
