"""What a person sees who prints an object: one line with what matters."""

import numpy as np
import pytest

from surrofe2 import (
    CachedLaw,
    LoadCase,
    MacroSettings,
    RveLaw,
    StressResponse,
    TrainingSettings,
    simulate,
    train,
)
from tests.laws import CELL, TrueLattice, lattice_samples


@pytest.fixture(scope="module")
def surrogate():
    settings = TrainingSettings(hidden=(4,), baseline_degree=1, iterations=1)
    return train(lattice_samples(100), settings)


def test_every_object_is_one_short_line(surrogate):
    law = RveLaw(CELL)
    run = simulate(LoadCase(duration=1.0, elements=(1, 1)), TrueLattice(), MacroSettings())
    samples = lattice_samples(100)
    expected = {
        law: "<RveLaw: 1 square cell ",
        surrogate: "<SurrogateLaw: cell ",
        CachedLaw(surrogate, law): "<CachedLaw: 0 hits; <SurrogateLaw: cell ",
    }
    shown = [(repr(each), begin) for each, begin in expected.items()]
    shown += [
        (repr(samples), "<StressSamples: 100, 0 of them failed; cell "),
        (repr(run), "<MacroRun: 1 elements, "),
        (repr(run.curve), "<DisplacementCurve: 3 times, 0 to 1 µs, largest displacement "),
        (repr(law.respond(np.eye(2)[None], np.zeros((1, 2, 2)))), "<StressResponse: 1 point>"),
    ]
    for text, begin in shown:
        assert text.startswith(begin), text
        assert "\n" not in text
        assert len(text) < 500


def test_what_failed_is_counted():
    answer = StressResponse(np.full((2, 2, 2), np.nan), np.array([0, 1], dtype=np.int8))
    assert repr(answer) == "<StressResponse: 2 points, 1 without stress>"
