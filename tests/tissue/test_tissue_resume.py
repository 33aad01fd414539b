"""Checkpoints of tissue runs: what is carried on is what would have been, bit by bit."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from surrofe2 import LoadCase
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.tissue import TissueSettings, TissueState, simulate_tissue
from tests.macro.bars import with_load

LOAD_CASE = LoadCase(
    width=50.0, height=50.0, watched=(50.0, 25.0), body_force=(0.5, -2.0), duration=3.0,
    output_interval=0.25, amplitude=((0.0, 0.0), (0.5, 1.0)),
)  # fmt: skip
SETTINGS = TissueSettings(skin=0.4, frames=5)


class Stop(KeyboardInterrupt):
    """Only ours, so that a real interrupt still ends the tests."""


@pytest.fixture(scope="module")
def simulate(reference):
    """The tissue of the settings under a load case."""
    cell, at_rest = reference("printed")
    return partial(simulate_tissue, cell=cell, settings=SETTINGS, reference=at_rest)


@pytest.fixture(scope="module")
def whole(simulate):
    return simulate(LOAD_CASE)


def stopped_at(simulate, when):
    states = []

    def stop(t, duration):
        assert duration == LOAD_CASE.duration
        if t >= when:
            raise Stop

    with pytest.raises(Stop):
        simulate(LOAD_CASE, progress=stop, checkpoint=states.append)
    (state,) = states
    return state


def test_results_belong_together(whole):
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


def test_checkpoints_come_with_every_output_time_when_asked(whole, simulate):
    states = []
    simulate(LOAD_CASE, checkpoint=states.append, checkpoint_interval=0.0)
    assert [state.rows for state in states] == list(range(2, 14))
    last = simulate(LOAD_CASE, resume=states[-1])
    np.testing.assert_array_equal(last.curve.displacement, whole.curve.displacement)


def test_checkpoint_of_another_run_is_refused(simulate):
    state = stopped_at(simulate, 0.5)
    other = with_load(LOAD_CASE, acceleration=(0.5, -1.0))
    with pytest.raises(MismatchError, match=r"resume: .* are not those of the checkpoint"):
        simulate(other, resume=state)
    arrays = state.to_arrays()
    del arrays["listed"]
    with pytest.raises(InputError, match="listed"):
        TissueState.from_arrays(arrays)
