"""Tables of surface laws: as good as they say, their slopes exact, and kept in files."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from surrofe2.base.errors import FileError, InputError, MismatchError
from surrofe2.law.surface_law import SurfaceResponse
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.store.tables import check_surface, read_surface, write_surface
from surrofe2.surface import SlabLaw, tabulate_surface
from tests.numerics import differences

RANGE, RATE = (0.97, 1.03), 0.01


@cache
def law():
    return SlabLaw(CellParameters.preset("water"), initialisation="slow-manifold", rows=4)


@cache
def table():
    return tabulate_surface(law(), RANGE, RATE)


def points(n, seed):
    return np.random.default_rng(seed).uniform((RANGE[0], -RATE), (RANGE[1], RATE), (n, 2)).T


def test_a_table_is_within_its_tolerance_of_the_slab():
    at = points(64, 7)
    wanted, found = law().respond(*at).tension, table().respond(*at)
    assert found.valid.all()
    assert np.abs(found.tension - wanted).max() < 1e-4 * table().spread
    assert table().spread == pytest.approx(np.ptp(wanted), rel=0.2)
    assert table().mass == law().mass


def test_tangents_are_those_of_the_polynomials():
    at = points(32, 8)
    found = table().respond(*at, tangents=True)
    slopes = differences(lambda each: table().respond(*each.T).tension, at.T, 1e-7, axes=1)
    tangents = np.stack([found.tangent, found.rate_tangent], axis=1)
    np.testing.assert_allclose(tangents, slopes, rtol=1e-5, atol=1e-3)


def test_values_are_sums_of_chebyshev_polynomials():
    at = points(16, 9)
    x = (2.0 * at[0] - sum(RANGE)) / (RANGE[1] - RANGE[0])
    wanted = np.polynomial.chebyshev.chebval2d(x, at[1] / RATE, table().coefficients)
    np.testing.assert_allclose(table().respond(*at).tension, wanted, rtol=1e-13)


def test_beyond_its_range_a_table_does_not_answer_or_the_slab_does():
    stretch, rate = np.array([0.96, 1.0, 1.0, 1.04]), np.array([0.0, 0.02, 0.0, 0.0])
    found = table().respond(stretch, rate, tangents=True)
    assert found.valid.tolist() == [False, False, True, False]
    for values in (found.tension, found.tangent, found.rate_tangent):
        assert np.isnan(values).tolist() == [True, True, False, True]
    whole = replace(table(), beyond=law).respond(stretch, rate, tangents=True)
    slab, out = law().respond(stretch, rate, tangents=True), ~found.valid
    assert whole.valid.all()
    for name in ("tension", "tangent", "rate_tangent"):
        np.testing.assert_allclose(getattr(whole, name)[out], getattr(slab, name)[out], rtol=1e-9)


def test_a_table_comes_back_from_its_file_and_belongs_to_its_plant_cell(tmp_path):
    path = tmp_path / "surface.h5"
    write_surface(path, table(), {"from": "a test"})
    found = read_surface(path)
    at = points(16, 10)
    assert np.array_equal(found.respond(*at).tension, table().respond(*at).tension)
    for name in ("mass", "depth", "width", "error", "spread"):
        assert getattr(found, name) == getattr(table(), name), name
    assert (found.depth, found.width) == (law().depth, 25.0)
    check_surface(path, found, law().cell, "slow-manifold")
    with pytest.raises(MismatchError, match=r"cell.outer_wall = 1.0, not 2.0"):
        check_surface(path, found, CellParameters.preset("water", outer_wall=2.0), "slow-manifold")
    with pytest.raises(MismatchError, match=r"cell.fluid_particle_mass"):
        check_surface(path, found, CellParameters(), "slow-manifold")
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(FileError):
        read_surface(path)


def test_a_range_without_extent_or_without_slabs_is_refused():
    with pytest.raises(InputError, match=r"surface: stretch \(1, 1\)"):
        tabulate_surface(law(), (1.0, 1.0), RATE)
    with pytest.raises(InputError, match=r"no stable slab at stretch 0\.9\d+, rate"):
        tabulate_surface(Torn(), RANGE, RATE)


class Torn:
    """A slab that bears no compression."""

    def respond(self, stretch, rate):
        return SurfaceResponse(np.where(stretch > 1.0, 0.0, np.nan))
