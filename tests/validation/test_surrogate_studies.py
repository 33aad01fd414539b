"""The ablation's regressors, and the search for the worst answer."""

import numpy as np

from surrofe2.base.sampling import SamplingRange, sample
from surrofe2.cache import CacheSettings
from tests.laws import Learnt, Truth, lattice_samples
from validation.ablation import GaussianProcess
from validation.worst_answer import Search, from_state, to_state


def test_a_gaussian_process_has_the_symmetry_of_the_square():
    """σ(F Q) with Q of the square's group, and σ(Q F) = Q σ Qᵀ."""
    law = GaussianProcess(lattice_samples(100))
    F, F_dot = sample(SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=0.01), 20, 7)
    stress = law.stress(F, F_dot)
    for Q in (np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([[1.0, 0.0], [0.0, -1.0]])):
        np.testing.assert_allclose(
            law.stress(Q @ F @ Q.T, Q @ F_dot @ Q.T), Q @ stress @ Q.T, rtol=1e-9, atol=1e-9
        )


class Peaked(Learnt):
    """Wrong by twice the tolerance on a peak that few states are near."""

    range = SamplingRange(stretch=(0.9, 1.1), shear=0.1, rate=0.01)

    def __init__(self):
        def error(F, F_dot):
            far = (F[:, 0, 0] - 1.05) ** 2 + (F[:, 1, 1] - 0.97) ** 2 + (F[:, 0, 1] - 0.03) ** 2
            return 2e-3 * self.stress_spread / (1.0 + 1e4 * far)

        super().__init__(error, lambda F, F_dot: np.full(len(F), 5e-4 * self.stress_spread))


def test_a_search_finds_the_error_that_random_states_do_not():
    found = Search(Peaked(), Truth(), CacheSettings())
    at = np.random.default_rng(0).uniform(-1.0, 1.0, (300, 7))
    np.testing.assert_allclose(from_state(*to_state(at, Peaked.range), Peaked.range), at)
    random = found.judge(at)
    starts = np.argsort(random)[-20:]
    assert random.max() < 1.0
    assert found.climb(at[starts], 60, seed=1).max() > 1.9
