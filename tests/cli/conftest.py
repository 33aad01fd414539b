"""The command line, by RVEs or by laws without cells."""

import pytest
from typer.testing import CliRunner

from surrofe2.cli import app
from surrofe2.workflow import laws
from tests.laws import SoftLaw

FIELDS = ["fields-last.xdmf", "fields.h5", "fields.xdmf", "frames"]
FILES = ["curve.csv", "energies.csv", *FIELDS, "input", "run.json"]
"""What a run folder holds at the end, whatever was run."""
TISSUE_FILES = sorted([*FILES, "history.csv"])
"""Those of all particles."""
RUN_FILES = sorted([*TISSUE_FILES, "points-last.xdmf", "points.h5", "points.xdmf"])
"""Those of finite elements over time."""


def call(*arguments, code=0, env=None, **settings):
    """Run a command, which ends with this exit code."""
    words, env = [str(each) for each in arguments], {"COLUMNS": "160", **(env or {})}
    done = CliRunner().invoke(app, words, env=env, **settings)
    assert done.exit_code == code, (done.output, done.exception)
    return done


@pytest.fixture
def stand_in(monkeypatch):
    """stand_in(law): put a law, or one of a class for each plant cell, in the place of RVEs."""

    def put(law=SoftLaw):
        make = law if isinstance(law, type) else lambda: law
        monkeypatch.setattr(
            laws, "true_law", lambda study: make().of(study.cell.parameters, study.recipe.rve)
        )

    return put


@pytest.fixture
def invoke(stand_in):
    """invoke(*arguments, law=…): run a command whose RVEs are `law`."""

    def run(*arguments, law=SoftLaw, **settings):
        stand_in(law)
        return call(*arguments, **settings)

    return run


@pytest.fixture
def surrogate_path(recipe_path):
    return recipe_path.with_name("cells-surrogate.h5")


@pytest.fixture
def data_set(invoke, recipe_path):
    invoke("generate", recipe_path)


@pytest.fixture
def trained(invoke, recipe_path, data_set):
    invoke("train", recipe_path)
