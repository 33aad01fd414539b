"""A cached law that keeps what stands."""

from __future__ import annotations

import numpy as np

from surrofe2.base.tensors import stress_error
from surrofe2.cache import CachedLaw


class Kept(CachedLaw):
    """Keeps (F, Ḟ, stress) of all accepted answers of the surrogate, by window that stands."""

    def __init__(self, *args):
        super().__init__(*args)
        self.open, self.standing = [], []

    def _learn(self, F, F_dot, response, state, accepted):
        free = response.state.free()
        self.open.append((F[free], F_dot[free], response.stress[free]))
        return super()._learn(F, F_dot, response, state, accepted)

    def mark(self, t, state):
        super().mark(t, state)
        self.standing, self.open = [*self.standing, self.open], []

    def roll_back(self, t):
        self.open = []
        return super().roll_back(t)

    def wrong_shares(self, law, allowed):
        """Of each window that stands: the share of its answers off by more than allowed."""
        for window in filter(None, self.standing):
            F, F_dot, stress = (np.concatenate(part) for part in zip(*window, strict=True))
            if len(F):
                error = stress_error(stress, law.respond(F, F_dot).stress)
                yield float(np.mean(error > allowed))
