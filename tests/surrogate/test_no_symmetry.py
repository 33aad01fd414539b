"""A surrogate of a cell without symmetry: a lattice turned by an odd angle has no parities."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.sampling import sample
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.surrogate import TrainingSettings, train
from tests.laws import (
    CELL,
    WELL_INSIDE,
    lattice_samples,
    lattice_stress,
)

IRREGULAR = CellParameters.preset("printed", arrangement="voronoi", cells=9)
TURN = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])


def turned_samples(cell, count=1500):
    samples = lattice_samples(count, cell=cell)
    return replace(samples, stress=lattice_stress(samples.F @ TURN, samples.F_dot @ TURN))


@pytest.fixture(scope="module")
def law():
    settings = TrainingSettings(hidden=(16, 16), baseline_degree=3, iterations=100)
    return train(turned_samples(IRREGULAR), settings)


@pytest.mark.parametrize(
    ("arrangement", "symmetry"), [("square", "D4"), ("hexagon", "none"), ("voronoi", "none")]
)
def test_only_the_square_takes_d4_for_granted(arrangement, symmetry):
    cell = CellParameters.preset("printed", arrangement=arrangement, cells=4)
    settings = TrainingSettings(hidden=(4,), baseline_degree=1, iterations=1)
    assert train(lattice_samples(200, cell=cell), settings).network.symmetry == symmetry


def test_learns_what_a_square_cell_could_not(law):
    """The same data with D4 taken for granted leaves errors of the order of the stress."""
    worst = max(law.errors["rms"].values())
    assert worst < 0.02
    settings = replace(law.settings, iterations=20)
    square = train(turned_samples(CELL, 800), settings)
    assert max(square.errors["rms"].values()) > 0.1 > 5.0 * worst


def test_rests_without_stress_and_turns_with_the_frame(law):
    assert not law.respond(np.eye(2)[None], np.zeros((1, 2, 2))).stress.any()
    F, F_dot = sample(WELL_INSIDE, 50, seed=1)
    Q = np.array([[0.6, -0.8], [0.8, 0.6]])
    stress = law.respond(F, F_dot).stress
    turned = law.respond(Q @ F, Q @ F_dot).stress
    np.testing.assert_allclose(turned, Q @ stress @ Q.T, rtol=0, atol=1e-11)
