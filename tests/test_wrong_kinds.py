"""Texts, arrays and other things in the place of numbers and names: one error message each."""

import dataclasses
from contextlib import suppress

import numpy as np
import pytest

import surrofe2
from surrofe2 import CellParameters
from surrofe2.base.errors import InputError
from surrofe2.problem import conditions
from surrofe2.problem.mesh import Box, Disc, HalfPlane, rectangle, with_boundaries, with_regions
from surrofe2.store.meshes import load_mesh

WRONG = ("x", np.array([1.0, 2.0]), np.ones((3, 3)), {}, [], object(), (1.0, "x"))
SETTINGS = [name for name in dir(surrofe2) if dataclasses.is_dataclass(getattr(surrofe2, name))]


@pytest.mark.parametrize("value", WRONG, ids=lambda value: type(value).__name__)
@pytest.mark.parametrize("name", sorted(SETTINGS))
def test_settings_take_or_refuse_what_they_are_not(name, value):
    kind = getattr(surrofe2, name)
    for field in dataclasses.fields(kind):
        if field.metadata and field.init:
            # a TypeError says that another argument is missing
            with suppress(InputError, TypeError):
                kind(**{field.name: value})


@pytest.mark.parametrize("value", WRONG, ids=lambda value: type(value).__name__)
@pytest.mark.parametrize(
    "make",
    [
        lambda value: rectangle(value, 1.0, (1, 1)),
        lambda value: rectangle(1.0, value, (1, 1)),
        lambda value: rectangle(1.0, 1.0, value),
        lambda value: rectangle(1.0, 1.0, (value, 1)),
        lambda value: Box(value, (1.0, 1.0)),
        lambda value: Box((0.0, 0.0), (value, 1.0)),
        lambda value: HalfPlane(value, (1.0, 0.0)),
        lambda value: Disc((0.0, 0.0), value),
        lambda value: with_boundaries(rectangle(1.0, 1.0, (1, 1)), a=value),
        lambda value: with_regions(rectangle(1.0, 1.0, (1, 1)), a=value),
        lambda value: load_mesh("a.msh", value),
        CellParameters.preset,
        lambda value: CellParameters.preset("printed", wall_stiffness=value),
        lambda value: CellParameters.preset("printed", arrangement=value),
        lambda value: conditions.Pressure(on="a", pressure=value),
        lambda value: conditions.Traction(on="a", traction=(value, 1.0)),
    ],
)
def test_constructors_refuse_what_they_cannot_take(make, value):
    with pytest.raises(InputError):
        make(value)


def test_numbers_of_numpy_are_numbers():
    mesh = rectangle(np.float32(2.0), np.int64(1), (np.int64(2), np.int32(1)))
    assert mesh.p.max() == 2.0
    assert CellParameters.preset("printed", wall_stiffness=np.int64(3000)).wall_stiffness == 3000.0
    with pytest.raises(InputError, match="an integer"):
        rectangle(1.0, 1.0, (True, 1))


def test_names_of_parts_are_spelt_with_the_micro_sign():
    """Python makes Greek mu of the micro sign in the name of an argument."""
    mesh = rectangle(1.0, 1.0, (1, 1))
    for name in ("\u00b5", "\u03bc"):
        assert "\u00b5" in with_regions(mesh, **{name: Disc((0.0, 0.0), 9.0)}).subdomains
        assert "\u00b5" in with_boundaries(mesh, **{name: Disc((0.0, 0.0), 9.0)}).boundaries
