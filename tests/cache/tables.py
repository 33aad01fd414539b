"""A bar, a table of the square law with states to look up, cached laws and what they keep."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from surrofe2 import LoadCase
from surrofe2.base.sampling import SamplingRange, sample
from surrofe2.base.tensors import stress_error
from surrofe2.cache import CachedLaw, CacheSettings, StressTable
from surrofe2.macro import MacroState, simulate
from tests.laws import Learnt, SquareLaw, Surrogate, Truth, square_stress
from tests.numerics import turn

LOAD_CASE = LoadCase(
    width=60.0, height=40.0, watched=(60.0, 20.0), elements=(4, 3), duration=12.0,
    output_interval=0.5,
)  # fmt: skip
RANGE = SamplingRange(stretch=(0.93, 1.07), shear=0.06, rate=0.016)
SPREAD = 3.0


def states(count=50, angle=0.4):
    U, A = sample(RANGE, count, 5)
    return turn(angle) @ U, turn(angle) @ A


def make(law=None, tolerance=5e-2, **settings):
    return StressTable(law or SquareLaw(), tolerance * SPREAD, RANGE, SPREAD, **settings)


def taught(F, F_dot, table=None):
    table = table or make()
    table.learn(F, F_dot, square_stress(F, F_dot))
    return table


def rising(least, slope):
    """A bound that rises with |F₂₁|, µN/µm."""
    return lambda F, F_dot: least + slope * abs(F[:, 1, 0])


def cached(error, bound, audit=0.0, *, kind=CachedLaw, truth=None, tolerance=0.01, **more):
    """A law of a surrogate off by an error and `truth`, with 0.1 µN/µm allowed."""
    settings = CacheSettings(tolerance=tolerance, audit=audit, **more)
    return kind(Learnt(error, bound), truth or Truth(), settings)


def observed(truth, surrogate=None, **settings):
    """A cached law, and what it hands to be kept and to be learnt."""
    kept, learnt = [], []
    law = CachedLaw(
        surrogate or Surrogate(),
        truth,
        CacheSettings(**settings),
        lambda *answer: kept.append(answer),
    )
    law.table = SimpleNamespace(learn=lambda *answers: learnt.append(answers), to_arrays=dict)
    return law, kept, learnt


def keeping(law, kept):
    """A checkpoint that keeps arrays: of each state, and of what the law makes of it."""
    return lambda state: kept.append((state.to_arrays(), law.state_to_arrays(state.law_state)))


def resumed(problem, law, settings, kept):
    """The run by a new law from what was kept."""
    arrays, of_law = kept
    state = replace(MacroState.from_arrays(arrays), law_state=law.state_from_arrays(of_law))
    return simulate(problem, law, settings, resume=state)


class Kept(CachedLaw):
    """Keeps (F, Ḟ, stress) of all accepted answers of the surrogate, by window that stands."""

    def __init__(self, *args):
        super().__init__(*args)
        self.open, self.standing = [], []

    def commit(self, F, F_dot, checked):
        free = checked.state.free()
        self.open.append((F[free], F_dot[free], checked.stress[free]))
        return super().commit(F, F_dot, checked)

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
