"""Checkpoints of tissue runs: what is carried on is what would have been, bit by bit."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.tissue import TissueState
from tests.macro.bars import assert_same_run, with_load

LOAD_CASE = LoadCase(
    width=50.0, height=50.0, watched=(50.0, 25.0), body_force=(0.5, -2.0), duration=3.0,
    output_interval=0.25, amplitude=((0.0, 0.0), (0.5, 1.0)),
)  # fmt: skip


@pytest.fixture(scope="module")
def simulate(run_tissue):
    return partial(run_tissue, LOAD_CASE, "printed", skin=0.4, frames=5)


@pytest.fixture(scope="module")
def checkpointed(simulate):
    """A run, and its state at each output time."""
    states = []
    return simulate(checkpoint=states.append, checkpoint_interval=0.0), states


def test_results_belong_together(checkpointed):
    whole, _ = checkpointed
    assert whole.finished
    frames = whole.frames
    assert frames.t.tolist() == [0.0, 0.75, 1.5, 2.25, 3.0]
    watched = abs(frames.displacement[-1] - whole.curve.displacement[-1]).sum(axis=1).argmin()
    assert whole.position[watched] == pytest.approx([50.0, 25.0], abs=6.0)
    assert whole.position[watched, 0] > 40.0
    assert whole.counts["particle_steps"] == whole.counts["steps"] * len(whole.position)
    lengths = np.linalg.norm(np.diff(whole.position[whole.bonds], axis=1)[:, 0], axis=1)
    assert len(whole.bonds) == 2 * 3 * 2 * 10
    assert 1.5 < lengths.min() < lengths.max() < 4.0
    assert whole.is_wall[whole.bonds].all()


def test_a_run_carried_on_from_a_checkpoint_is_the_whole_one(checkpointed, simulate):
    whole, states = checkpointed
    assert [state.rows for state in states] == list(range(2, 14))
    again = simulate(resume=TissueState.from_arrays(states[7].to_arrays()))
    assert_same_run(again, whole)


def test_checkpoint_of_another_run_is_refused(checkpointed, run_tissue):
    state = checkpointed[1][0]
    other = with_load(LOAD_CASE, acceleration=(0.5, -1.0))
    with pytest.raises(MismatchError, match=r"resume: .* are not those of the checkpoint"):
        run_tissue(other, "printed", skin=0.4, frames=5, resume=state)
    arrays = state.to_arrays()
    del arrays["relaxed"]
    with pytest.raises(InputError, match="relaxed"):
        TissueState.from_arrays(arrays)
