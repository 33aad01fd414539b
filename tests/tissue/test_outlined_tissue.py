"""Full tissue along the outlines of an image: the tissue of squares, identities, equilibrium."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from surrofe2.base.errors import InputError
from surrofe2.plant_cell.arrangement import ReferenceState, rim_areas
from surrofe2.plant_cell.outlined import outline_cells
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem import Fixed, Pressure, Problem, rectangle
from surrofe2.rve import RveLaw
from surrofe2.tissue import TissueDynamics
from surrofe2.tissue.relaxation import relax
from surrofe2.tissue.simulation import make_conditions, meet_bodies, outlined_conditions
from tests.numerics import assert_near
from tests.questions.test_cell_image import squares
from tests.tissue.motion import assert_force_is_minus_the_gradient_of_the_energy, placed, shaken

pytest.importorskip("skimage")
from skimage import draw, segmentation

APPLE = CellParameters.preset("apple")
SIDE = APPLE.cell_side


def problem_on(width, height, *conditions):
    return Problem(
        mesh=rectangle(width, height, (1, 1)),
        conditions=conditions or (Fixed(on="left"),),
        duration=1.0,
        output_interval=1.0,
    )


def image_of_cells(space=False, cells=9):
    """Labels (60, 90) of cells about random points, with an air space between them or not."""
    seeds = np.zeros((60, 90), dtype=np.int64)
    seeds.flat[np.random.default_rng(5).choice(seeds.size, cells, replace=False)] = np.arange(
        1, cells + 1
    )
    labels = segmentation.expand_labels(seeds, distance=200)
    if space:
        labels[draw.disk((30.0, 45.0), 7.0)] = 0
    return labels


def conditions_of(labels, *conditions, rest_length=None):
    """At the scale at which the image's cells have the size of the plant cell."""
    pixel = SIDE / np.sqrt(labels.size / labels.max())
    rows, columns = labels.shape
    problem = problem_on(columns * pixel, rows * pixel, *conditions)
    image = outline_cells(labels, pixel, APPLE.spring_length)
    at, lattice = image.arrangement.wall_position, image.arrangement.tessellation.lattice
    known = (
        () if rest_length is None else ReferenceState(APPLE.fingerprint, at, lattice, rest_length)
    )
    return outlined_conditions(problem, APPLE, image, known)


def test_an_image_of_squares_is_the_tissue_of_squares():
    """With the rest length of the RVE, whose springs differ a little from each other at rest."""
    problem = problem_on(3.0 * SIDE, 2.0 * SIDE)
    reference = RveLaw(APPLE).reference
    known = make_conditions(problem, APPLE, reference)
    image = outline_cells(squares(2, 3), SIDE / 20.0, APPLE.spring_length)
    sought = outlined_conditions(problem, APPLE, image).tissue.references[0]
    assert sought.rest_length == pytest.approx(reference.rest_length, rel=1e-3)
    same = replace(sought, rest_length=reference.rest_length)
    made = outlined_conditions(problem, APPLE, image, same)
    # where walls meet on the outline, the air beside them counts as one neighbour here
    assert made.tissue.mass.sum() == pytest.approx(known.tissue.mass.sum(), rel=1e-3)
    rest = [relax(TissueDynamics(each.tissue), 1e-6) for each in (known, made)]
    distance, order = cKDTree(rest[1]).query(rest[0])
    assert distance.max() < 1e-5 * SIDE
    assert np.unique(order).size == len(rest[1])
    assert_near(made.outline_places[order], known.outline_places, 1e-9)


@pytest.mark.parametrize("space", [False, True])
def test_forces_are_minus_the_gradient_of_the_energy(space):
    tissue = conditions_of(image_of_cells(space), rest_length=13.0).tissue
    x, v = shaken(tissue)
    f = placed(tissue, x, v).forces()
    assert abs(f.sum(axis=0)).max() < 1e-14 * abs(f).max() * len(f)
    assert_force_is_minus_the_gradient_of_the_energy(tissue, x, step=1e-5, directions=2)


@pytest.mark.parametrize("space", [False, True])
def test_a_pressure_on_the_outline_is_that_of_a_bath_unless_there_are_air_spaces(space):
    """A bath takes its pressure from every plant cell: −Π times the gradient of all their area."""
    bath = 0.4  # µN/µm
    sides = ("left", "right", "bottom", "top")
    loads = [Pressure(on=side, pressure=bath) for side in sides]
    conditions = conditions_of(image_of_cells(space), *loads, rest_length=13.0)
    tissue = conditions.tissue
    dynamics = TissueDynamics(tissue)
    meet_bodies(dynamics, conditions, dynamics.x)
    pressed = dynamics.forces(amplitudes=np.ones(4)) - dynamics.forces(amplitudes=np.zeros(4))
    gradient = np.zeros_like(pressed)
    position = np.zeros_like(gradient)
    particle = tissue.address[:, 1]
    position[particle] = dynamics.x
    for rim, kind in zip(tissue.arrangement.rims, tissue.kind[0, 0], strict=True):
        around = position[rim[:, 0]]
        across = 0.5 * (np.roll(around, -1, axis=0) - np.roll(around, 1, axis=0))
        if kind == 0:
            np.add.at(gradient, rim[:, 0], across @ [[0.0, -1.0], [1.0, 0.0]])
    difference = pressed + bath * gradient[particle]
    if space:
        assert abs(difference).max() > 0.1 * abs(pressed).max()
    else:
        assert abs(difference).max() < 1e-12 * abs(pressed).max()


@pytest.mark.slow
def test_at_rest_the_plant_cells_within_keep_their_size():
    conditions = conditions_of(image_of_cells(cells=16))
    tissue, arrangement = conditions.tissue, conditions.tissue.arrangement
    rest = np.zeros((tissue.particles, 2))
    rest[tissue.address[:, 1]] = relax(TissueDynamics(tissue), 1e-3)
    after = rim_areas(arrangement.rims, rest, np.eye(2))
    outer = np.unique(arrangement.rims[int(np.flatnonzero(tissue.kind[0, 0] < 0)[0])])
    within = [k for k, rim in enumerate(arrangement.rims) if not np.isin(rim[:, 0], outer).any()]
    assert len(within) >= 2
    before = arrangement.tessellation.areas
    assert after[within].sum() == pytest.approx(before[within].sum(), rel=0.006)


def test_a_mesh_may_hold_a_part_of_an_image():
    """The left half of squares is the tissue of an image of these squares alone."""
    whole = outline_cells(squares(4, 6), SIDE / 20.0, APPLE.spring_length)
    half = outline_cells(squares(4, 3), SIDE / 20.0, APPLE.spring_length)
    problem = problem_on(3.0 * SIDE, 4.0 * SIDE)
    part, alone = (outlined_conditions(problem, APPLE, image).tissue for image in (whole, half))
    assert part.particles == alone.particles < whole.arrangement.particles
    assert part.references[0].rest_length == pytest.approx(alone.references[0].rest_length, 1e-4)


def test_an_image_takes_one_type_of_cells_and_a_mesh_that_they_fill():
    labels = image_of_cells()
    image = outline_cells(labels, 1.0, 5.0)
    with pytest.raises(InputError, match="image: 2 types of cells"):
        outlined_conditions(problem_on(90.0, 60.0), [APPLE, APPLE], image)
    with pytest.raises(InputError, match="fluid is sph"):
        outlined_conditions(problem_on(90.0, 60.0), CellParameters.preset("printed"), image)
    with pytest.raises(InputError, match="the image is 90 × 60 µm, from"):
        outlined_conditions(problem_on(200.0, 60.0), APPLE, image)
