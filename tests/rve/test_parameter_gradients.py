"""Gradients of the stress by cell parameters against central differences of whole laws."""

from __future__ import annotations

import numpy as np
import pytest

from surrofe2 import (
    CellParameters,
    RveLaw,
    follow_path,
    parameter_gradients,
    path_gradients,
    ramp_and_hold,
)
from surrofe2.errors import InputError
from surrofe2.rve.parameter_gradients import PARAMETERS
from tests.rve.rves import clear_of_the_cut_off, deformations, law, piola

FEW = ("wall_stiffness", "viscosity", "smoothing_length", "cell_side")
LINEAR = ("viscosity", "wall_damping_ratio", "contact_damping_ratio")
"""What acts on rates alone, little here, so that long steps tell it from rounding."""


def changed(this, **parameters):
    """The law with other parameters, its reference settled anew."""
    return RveLaw(CellParameters(**{**this.cell.to_dict(), **parameters}), this.settings)


def difference(of, this, name, h):
    """∂of(law)/∂parameter by central differences of fourth order, in relative steps h."""
    value = this.cell.to_dict()[name]
    at = {k: of(changed(this, **{name: value * (1.0 + k * h)})) for k in (-2, -1, 1, 2)}
    return (8.0 * (at[1] - at[-1]) - at[2] + at[-2]) / (12.0 * h * value)


def check(this, names, count):
    """Relative to the largest, at points whose pairs stay clear of the cut-off."""
    F, F_dot = deformations("printed", n=count, corners=False)
    found = parameter_gradients(this, F, F_dot, names)
    clear = clear_of_the_cut_off(found.answer, F, wide=5e-3)
    assert clear.sum() > 0.4 * count
    for name in names:
        h = 0.2 if name in LINEAR else 1e-4
        exact = difference(lambda law: piola(law, F, F_dot, None), this, name, h)
        error = np.abs(found.P_by[name] - exact)[clear].max()
        assert error < 1e-6 * np.abs(exact[clear]).max(), name


@pytest.mark.slow
def test_they_are_the_slopes_of_whole_laws():
    check(law("printed", tolerance=1e-10), FEW, 40)


@pytest.mark.slow
@pytest.mark.parametrize("initialisation", ["elastic", "constrained-runs", "slow-manifold"])
def test_all_of_them_are(initialisation):
    """On the slow manifold velocities move with the parameters, too."""
    check(law("printed", initialisation, tolerance=1e-10), PARAMETERS, 100)


@pytest.mark.slow
def test_hexagons_keep_their_fluid():
    this = RveLaw(CellParameters(arrangement="hexagon"), law("printed", tolerance=1e-10).settings)
    F, F_dot = deformations("printed", n=8, corners=False)
    F = np.eye(2) + 0.1 * (F - np.eye(2))
    names = ("fluid_particle_mass", "cell_side")
    found = parameter_gradients(this, F, F_dot, names)
    for name in names:
        exact = difference(lambda law: piola(law, F, F_dot, None), this, name, 1e-4)
        error = np.abs(found.P_by[name] - exact).max(axis=(1, 2))
        assert np.median(error) < 1e-6 * np.abs(exact).max(), name


@pytest.mark.slow
def test_a_path_creeps_otherwise_with_other_parameters():
    """A tensile test with free sides, against whole paths of other laws."""
    this = RveLaw(CellParameters.preset("water", viscosity=50.0))
    motion = ramp_and_hold(np.diag([1.02, 1.0]), 1.0)

    def stress(law):
        return follow_path(law, motion, 1.5, 12, free=[(1, 1)]).first_piola

    path = follow_path(this, motion, 1.5, 12, free=[(1, 1)])
    found = path_gradients(this, path, ("viscosity",), free=[(1, 1)])["viscosity"]
    exact = difference(stress, this, "viscosity", 5e-3)
    assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()
    held = path_gradients(this, path, ("viscosity",))["viscosity"]
    assert np.abs(held - exact).max() > 0.02 * np.abs(exact).max()


def test_what_has_no_gradients_says_so():
    F, F_dot = np.eye(2)[None], np.zeros((1, 2, 2))
    with pytest.raises(InputError, match="names: 'wall'; it must be among wall_stiffness"):
        parameter_gradients(law("printed"), F, F_dot, ["wall"])
    with pytest.raises(InputError, match="parameter_gradients: RveLaw has no tangents"):
        parameter_gradients(law("printed", solver="iterated"), F, F_dot)
    with pytest.raises(InputError, match="law: cauchy-born, square; gradients by parameters need"):
        parameter_gradients(law("printed", "cauchy-born"), F, F_dot)
