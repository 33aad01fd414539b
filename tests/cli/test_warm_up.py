"""What is asked before a run's clock starts."""

import numpy as np
import pytest

from surrofe2.macro import MacroSettings
from surrofe2.surrogate.compiled_lookup import MANY
from surrofe2.workflow import laws
from surrofe2.workflow.run import run_study
from tests.laws import SoftLaw


class Watched(SoftLaw):
    """Notes how many points it was asked for."""

    def __init__(self, **settings):
        super().__init__(**settings)
        self.asked = []

    def respond(self, F, F_dot, state=None, *, tangents=False):
        self.asked.append(len(F))
        return super().respond(F, F_dot, state)


@pytest.mark.parametrize(("elements", "points"), [((4, 4), 80), ((64, 64), 2048)])
def test_every_law_is_asked_for_as_many_points_as_change_its_way(elements, points):
    first, last = Watched(), Watched()
    taken = laws.warm_up((first, last), MacroSettings(elements=elements))
    assert last.asked == [1, 1, points, points]
    assert first.asked[:4] == last.asked
    assert set(first.asked[4:]) == {20}
    assert taken > 0.0
    assert points <= 80 or points >= MANY


def test_a_law_that_cannot_start_is_left_to_the_run():
    law = Watched(fails_above=0.5)
    laws.warm_up((law,), MacroSettings())
    assert set(law.asked) == {80, 20}


def test_a_run_after_it_compiles_nothing(recipe):
    from numba.core import event

    from surrofe2.macro import simulate

    class Compilations(event.Listener):
        names = ()

        def on_start(self, happening):
            self.names = (*self.names, happening.data["dispatcher"].py_func.__name__)

        def on_end(self, happening):
            pass

    chosen = laws.choose_law(recipe, "rve")
    laws.warm_up(chosen.parts, recipe.macro)
    seen = Compilations()
    with event.install_listener("numba:compile", seen):
        done = simulate(recipe.load, chosen.law, recipe.macro)
    assert done.counts["steps"] > 1
    assert np.isfinite(done.curve.displacement).all()
    assert seen.names == ()


def test_the_bar_says_that_kernels_are_loaded_until_the_first_step(recipe, tmp_path, monkeypatch):
    monkeypatch.setattr(laws, "true_law", lambda part, *_: SoftLaw().of(part.cell, part.rve))
    told = []
    run_study(recipe, "rve", tmp_path / "run", report=lambda t, note: told.append((t, note)))
    assert told[0] == (0.0, "loading kernels")
    assert told[1][0] > 0.0
    assert {note for _, note in told[1:]} == {""}
