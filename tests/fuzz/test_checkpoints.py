"""Checkpoints whose digest is right and whose content is not: a run to its end, or a sentence."""

from __future__ import annotations

from shutil import copytree, rmtree

import numpy as np
import pytest
from hypothesis import given

from tests import commands
from tests.faults import Killed, fault_at
from tests.fuzz.fuzzing import Content, answered, examples
from tests.fuzz.stored import other_hdf5
from tests.test_faults_of_commands import learnt  # noqa: F401 - a fixture

NAMES = ("cached and table", "table", "implicit", "tissue")
KILLED_AT = 40


@pytest.mark.parametrize(
    ("name", "number"),
    [("cached", 25), *(pytest.param(each, 250, marks=pytest.mark.slow) for each in NAMES)],
)
def test_forged_checkpoints(name, number, tmp_path, learnt):  # noqa: F811
    begun, forged = tmp_path / "begun", tmp_path / "forged"
    commands.prepare(name, begun, learnt)
    with pytest.raises(Killed), fault_at("killed", KILLED_AT):
        commands.execute(name, begun)
    whole = Content((begun / "out" / "checkpoint.h5").read_bytes())
    finished = []

    @examples(number)
    @given(other_hdf5(whole))
    def changed(content):
        copytree(begun, forged)
        (forged / "out" / "checkpoint.h5").write_bytes(content)
        with np.errstate(all="ignore"), answered("checkpoint"):
            commands.execute(name, forged)
            finished.append(content)
        rmtree(forged)

    changed()
    assert len(finished) < number
