"""Harvested states join samples that have tangents."""

from dataclasses import replace

import numpy as np
import pytest

from surrofe2.base.sampling import sample
from surrofe2.law.samples import StressSamples
from surrofe2.recipe.recipe import Recipe, load_recipe
from surrofe2.store.samples import HarvestWriter
from surrofe2.workflow.generate import with_harvests
from surrofe2.workflow.run import origin_of
from tests.laws import SquareLaw, square_stress

KNOWN, HARVESTED, FAILED, OTHERWISE = 40, 30, 3, 2


@pytest.fixture
def recipe(recipe_path) -> Recipe:
    return load_recipe(recipe_path)


@pytest.fixture
def samples(recipe):
    F, F_dot = sample(recipe.range, KNOWN, 1)
    answer = SquareLaw().respond(F, F_dot, tangents=True)
    return StressSamples(
        F=F,
        F_dot=F_dot,
        stress=answer.stress,
        status=answer.status,
        cell=recipe.cell,
        initialisation=recipe.rve.initialisation,
        range=recipe.range,
        seed=1,
        P_by_F=answer.tangents.P_by_F,
        P_by_F_dot=answer.tangents.P_by_F_dot,
    )


@pytest.fixture
def harvest(recipe, tmp_path):
    """The first states failed, the next were on another branch."""
    F, F_dot = sample(recipe.range, HARVESTED, 2)
    stress = square_stress(F, F_dot)
    status = np.zeros(HARVESTED, dtype=np.int8)
    stress[:FAILED], status[:FAILED] = np.nan, 1
    stress[FAILED : FAILED + OTHERWISE] += 0.1
    path = tmp_path / "harvest.h5"
    writer = HarvestWriter(path, origin_of(recipe))
    writer(F, F_dot, stress, status, np.zeros(HARVESTED, dtype=np.int8))
    writer.flush()
    return path


def test_harvested_states_get_the_tangents_they_lack(samples, harvest, recipe, caplog):
    joined = with_harvests(samples, [harvest], recipe, SquareLaw())
    new = slice(KNOWN, None)
    assert len(joined.F) == KNOWN + HARVESTED - OTHERWISE
    np.testing.assert_array_equal(joined.P_by_F[:KNOWN], samples.P_by_F)
    valid = joined.status == 0
    assert (~valid).sum() == FAILED
    exact = SquareLaw().respond(joined.F[valid], joined.F_dot[valid], tangents=True)
    np.testing.assert_allclose(joined.P_by_F[valid], exact.tangents.P_by_F, atol=1e-12)
    np.testing.assert_allclose(joined.P_by_F_dot[valid], exact.tangents.P_by_F_dot, atol=1e-12)
    assert np.isnan(joined.P_by_F[new][:FAILED]).all()
    np.testing.assert_allclose(joined.stress[valid], exact.stress, atol=1e-12)
    assert f"{OTHERWISE} harvested states left out" in caplog.text


def test_without_tangents_every_harvested_state_is_taken(samples, harvest, recipe):
    plain = replace(samples, P_by_F=None, P_by_F_dot=None)
    joined = with_harvests(plain, [harvest], recipe)
    assert len(joined.F) == KNOWN + HARVESTED
    assert joined.P_by_F is None
    assert with_harvests(samples, [], recipe) is samples
