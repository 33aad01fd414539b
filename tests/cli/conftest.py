"""The command line over laws without cells."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from surrofe2.cli import app
from surrofe2.workflow import laws
from tests.laws import SoftLaw


@pytest.fixture
def invoke(monkeypatch):
    """invoke(*arguments, law=…): run a command whose RVEs are `law`."""

    def run(*arguments, law=None, **settings):
        soft = law or SoftLaw()
        monkeypatch.setattr(laws, "true_law", lambda recipe, *_: soft.of(recipe.cell, recipe.rve))
        return CliRunner().invoke(app, [str(entry) for entry in arguments], **settings)

    return run
