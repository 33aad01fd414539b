"""A relaxed plant cell of each preset, once for all tests of the tissue."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.tissue import TissueSettings, simulate_tissue
from surrofe2.tissue.layout import make_tissue


@pytest.fixture(scope="session")
def reference():
    """reference(preset): cell and its reference state."""

    def of(preset):
        cell = CellParameters.preset(preset)
        return cell, RveLaw(cell).reference

    return of


@pytest.fixture(scope="session")
def tissue_of(reference):
    """tissue_of(cells, preset)."""

    def make(cells, preset="printed"):
        cell, at_rest = reference(preset)
        return make_tissue([cell], [at_rest], np.zeros(cells, dtype=int))

    return make


@pytest.fixture(scope="session")
def run_tissue(reference):
    """run_tissue(problem, preset, changes, **how): `how` are settings or what a run takes."""

    def run(problem, preset="water", changes=None, **how):
        cell, at_rest = reference(preset)
        cell = replace(cell, **(changes or {}))
        at_rest = replace(at_rest, fingerprint=cell.fingerprint)
        names = {"checkpoint", "checkpoint_interval", "resume"} & how.keys()
        given = {name: how.pop(name) for name in names}
        settings = TissueSettings(**{"frames": 2, **how})
        return simulate_tissue(problem, cell, settings, reference=at_rest, **given)

    return run


@pytest.fixture(scope="session")
def types():
    """Two cells that differ in all that may differ, and their reference states."""
    soft = CellParameters.preset("water")
    stiff = replace(
        soft, wall_stiffness=5000.0, wall_particle_mass=0.7, wall_damping_ratio=0.8,
        repulsion_strength=4e5, contact_damping_ratio=0.9, smoothing_length=5.2,
        fluid_particle_mass=0.4, sound_speed=45.0, viscosity=0.2,
    )  # fmt: skip
    return [soft, stiff], [RveLaw(cell).reference for cell in (soft, stiff)]
