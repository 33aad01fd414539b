"""Run folders with a damaged file in them: compared, or one sentence that names the folder."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surrofe2.report.comparison import compare
from surrofe2.store.run_folder import read_run
from tests.fuzz.fuzzing import Content, answered, damaged_bytes, examples, few_and_all
from tests.fuzz.stored import KINDS

PARTS = ("run.json", "curve.csv", "history.csv")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A folder with a whole run, and the bytes of its files."""
    folder = tmp_path_factory.mktemp("runs") / "whole"
    folder.mkdir()
    for name in reversed(PARTS):
        KINDS[name][0](folder)
    return folder, {name: Content((folder / name).read_bytes()) for name in PARTS}


@st.composite
def damaged_run(draw, contents):
    """Files of a run of which one is damaged or missing."""
    found = dict(contents)
    name = draw(st.sampled_from(PARTS))
    found[name] = draw(damaged_bytes(contents[name]))
    if draw(st.integers(0, 9)) == 0:
        del found[draw(st.sampled_from(PARTS))]
    return found


@few_and_all(30, 500)
def test_damaged_runs(run, number):
    whole, contents = run
    folder = whole.parent / "damaged"

    @examples(number)
    @given(damaged_run(contents))
    def check(files):
        read_and_compare(whole, folder, files)

    check()


def read_and_compare(whole, folder, files):
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    with np.errstate(all="ignore"), answered("damaged", "displacement curves"):
        result = compare([read_run(whole), read_run(folder)])
        json.dumps(result.to_dict())
