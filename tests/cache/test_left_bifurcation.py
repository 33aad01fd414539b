"""The fallback leaves a bifurcation: the cache passes it on, and learns and keeps none of it."""

from dataclasses import dataclass, replace

import numpy as np

from surrofe2.cache import CachedLaw
from surrofe2.law.stress_law import Acceptance
from tests.laws import PointStates, Surrogate, TrueLaw, stretched


@dataclass(frozen=True)
class Branch(PointStates):
    """A state beyond a bifurcation where F₁₁ > 1.6."""

    def take(self, indices):
        return Branch(self.F[indices])

    def put(self, indices, state):
        return Branch(super().put(indices, state).F)

    @property
    def left_points(self):
        return self.F[:, 0, 0] > 1.6


class Leaving(TrueLaw):
    """Leaves at accepted steps where F₁₁ > 1.6, and has a stress of 7 everywhere from there."""

    def respond(self, F, F_dot, state=None, *, tangents=False):
        answer = super().respond(F, F_dot, state)
        return replace(answer, state=Branch(F.copy()))

    def accept(self, F, F_dot, response):
        left = response.state.left_points
        stress = np.where(left[:, None, None], 7.0, response.stress)
        return Acceptance(response.status, response.state, stress, left)


def test_stress_beyond_a_bifurcation_is_passed_on_but_neither_kept_nor_learnt():
    kept, learnt, surrogate = [], [], Surrogate()
    surrogate.learn = lambda F, F_dot, stress, state: learnt.append(F[:, 0, 0].tolist())
    cached = CachedLaw(
        surrogate, Leaving(), on_true_answer=lambda F, *_: kept.append(F[:, 0, 0].tolist())
    )
    F, F_dot = stretched(1.1, 1.7, 1.55)
    first = cached.respond(F, F_dot)
    accepted = cached.accept(F, F_dot, first)
    assert accepted.left_bifurcation.tolist() == [False, True, False]
    assert (accepted.stress[1] == 7.0).all()
    np.testing.assert_array_equal(accepted.stress[[0, 2]], first.stress[[0, 2]])
    assert kept == learnt == [[1.55]]
