"""The micro step that a plant cell bears."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.base.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.tissue import TissueSettings, simulate_tissue
from surrofe2.tissue.relaxation import rounded_step, stable_step
from tests.numerics import assert_near


def run(cell, **settings):
    """Two by two plant cells pulled down for 2 µs."""
    side = cell.cell_side
    load = LoadCase(
        width=2.0 * side, height=2.0 * side, watched=(2.0 * side, side), duration=2.0,
        body_force=(0.0, -12.5 / side), output_interval=0.5,
    )  # fmt: skip
    return simulate_tissue(load, cell, TissueSettings(**settings), reference=RveLaw(cell).reference)


@pytest.mark.parametrize("preset", ["printed", "water", "apple", "potato"])
def test_presets_keep_the_step_of_two_nanoseconds(preset):
    cell = CellParameters.preset(preset)
    assert rounded_step(stable_step(cell, RveLaw(cell).reference)) == 2e-3


def test_without_damping_the_limit_is_two_over_the_largest_frequency():
    """Nearly that of the walls: a chain's largest is 2 √(k/m), so the limit is √(m/k)."""
    cell = CellParameters.preset("printed")
    undamped = replace(cell, wall_damping_ratio=0.0, contact_damping_ratio=0.0, viscosity=0.0)
    reference = replace(RveLaw(cell).reference, fingerprint=undamped.fingerprint)
    found = stable_step(undamped, reference)
    chain = (cell.wall_particle_mass / cell.wall_stiffness) ** 0.5
    assert 0.8 * chain < found < 1.02 * chain


@pytest.mark.parametrize(
    "cell",
    [CellParameters.preset("printed", wall_stiffness=stiffness) for stiffness in (4400.0, 6000.0)]
    + [CellParameters.preset(name) for name in ("apple", "potato")],
    ids=["stiff", "stiffer", "apple", "potato"],
)
def test_plant_cells_get_a_step_that_they_bear(cell):
    done = run(cell)
    energies = done.energies
    assert np.abs(energies["balance"]).max() < 1e-3 * np.abs(energies["load"]).max()
    half = run(cell, micro_step=0.5 * rounded_step(stable_step(cell, RveLaw(cell).reference)))
    assert_near(done.curve.displacement, half.curve.displacement, 1e-3)


def test_a_step_near_the_limit_is_refused_and_the_limit_named():
    """At 0.95 of the limit at rest this run grew to 270,000 µm without an error."""
    cell = CellParameters.preset("printed", wall_stiffness=6000.0)
    limit = stable_step(cell, RveLaw(cell).reference)
    for share in (0.95, 1.02, 2.0):
        with pytest.raises(InputError) as caught:
            run(cell, micro_step=share * limit)
        message = str(caught.value)
        assert message.startswith(f"tissue.micro_step: {share * limit:.4g} µs; at most")
        assert f"the limit of stability at rest is {limit:.4g} µs" in message
        assert "leave it out or take 0.0016" in message
    within = run(cell, micro_step=0.86 * limit)
    assert_near(within.curve.displacement, run(cell).curve.displacement, 1e-3)
