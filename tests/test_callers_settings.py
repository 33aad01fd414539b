"""What a caller may have set of the process changes no bit of any law, and no file."""

import json
import os
import shutil
import subprocess

import pytest

from tests.all_laws import figures
from tests.conftest import ROOT
from tests.processes import python


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """Figures of all laws in this process."""
    return figures(tmp_path_factory.mktemp("known"))


@pytest.fixture(scope="module")
def decimal_commas(tmp_path_factory):
    """Environment of a locale with decimal commas, made where the system has its source."""
    folder = tmp_path_factory.mktemp("locales")
    if shutil.which("localedef") is None:
        pytest.skip("no localedef: the locale de_DE.UTF-8 cannot be made")
    words = ["localedef", "-i", "de_DE", "-f", "UTF-8", folder / "de_DE.UTF-8"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if not (folder / "de_DE.UTF-8" / "LC_NUMERIC").exists():
        pytest.skip(f"the locale de_DE.UTF-8 cannot be made: {done.stderr}")
    return {"LOCPATH": str(folder), "LC_ALL": "de_DE.UTF-8"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        ("numpy", "warnings", "locale", "forkserver"),
        *(
            pytest.param((each,), marks=pytest.mark.slow)
            for each in ("numpy", "warnings", "locale", "spawn")
        ),
    ],
    ids=" ".join,
)
def test_no_law_depends_on_what_its_caller_has_set(settings, known, decimal_commas, tmp_path):
    done = python(
        "-m", "tests.all_laws", tmp_path, *settings, cwd=ROOT, env=os.environ | decimal_commas
    )
    assert json.loads(done.stdout) == known
    assert not done.stderr
