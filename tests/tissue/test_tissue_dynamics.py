"""Leapfrog steps of a tissue: order, momentum, lists, threads, stable lengths, checkpoints."""

from dataclasses import replace
from functools import partial

import numba
import numpy as np
import pytest

from surrofe2 import LoadCase, Table
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.tissue import TissueDynamics, TissueSettings, TissueState, relax, simulate_tissue
from surrofe2.tissue.relaxation import rounded_step, stable_step
from surrofe2.tissue.simulation import held_and_loaded, make_conditions
from tests.macro.bars import assert_same_run, with_load
from tests.numerics import assert_near
from tests.tissue.twin import TissueTwin

LOAD_CASE = LoadCase(
    width=50.0, height=25.0, watched=(50.0, 12.5), body_force=(0.0, -2.0), duration=1.0,
    output_interval=0.25,
)  # fmt: skip
UNDAMPED = {"wall_damping_ratio": 0.0, "contact_damping_ratio": 0.0, "viscosity": 0.0}


@pytest.mark.parametrize(
    ("preset", "changes", "order"),
    [("printed", {}, 1), ("water", {}, 1), ("printed", UNDAMPED, 2)],
)
def test_order_of_displacement_and_of_energy_balance(run_tissue, preset, changes, order):
    """Lagged velocities in the dashpots: first order; without damping leapfrog's second."""
    settings = {"residual": 1e-8, "energy_steps": 4}
    runs = [
        run_tissue(LOAD_CASE, preset, changes, micro_step=step, **settings)
        for step in (1e-3, 5e-4, 2.5e-4)
    ]
    last = [one.curve.displacement[-1, 1] for one in runs]
    balance = [abs(one.energies["balance"]).max() for one in runs]
    rate = np.log2((last[0] - last[1]) / (last[1] - last[2]))
    assert rate == pytest.approx(order, abs=0.25)
    assert np.log2(balance[1] / balance[2]) == pytest.approx(order, abs=0.3)
    assert balance[0] < 1e-3 * runs[0].energies["load"].max()
    assert abs(last[0] - last[2]) < 1e-3 * abs(last[2])


def test_a_load_that_comes_and_goes_between_two_samples_of_the_energy_does_work(run_tissue):
    blow = with_load(
        LOAD_CASE, amplitude=Table(points=((0.0, 0.0), (0.02, 1.0), (0.04, 0.0), (1.0, 0.0)))
    )
    energies = run_tissue(blow, "printed", micro_step=1e-3, energy_steps=50).energies
    assert energies["kinetic"].max() > 0.0
    assert abs(energies["balance"]).max() < 0.02 * energies["load"].max()


def test_held_walls_stay_and_energies_are_shared_out(run_tissue):
    done = run_tissue(LOAD_CASE, micro_step=2e-3, residual=1e-8, energy_steps=4)
    energies = done.energies
    assert energies["kinetic"][0] == energies["load"][0] == energies["elastic"][0] == 0.0
    assert (np.diff(energies["dissipated"]) > 0.0).all()
    held = done.is_wall & (abs(done.position[:, 0]) < 1e-9)
    assert held.sum() == 11
    assert not done.frames.displacement[-1, held].any()
    assert abs(done.frames.displacement[-1, ~held]).max() > 0.1


def test_balanced_load_leaves_momentum_alone(tissue_of):
    tissue = tissue_of((2, 2), "water")
    load = np.random.default_rng(5).normal(size=(tissue.particles, 2))
    load -= load.mean(axis=0)
    dynamics = TissueDynamics(tissue, loads=load[None])
    start = dynamics.x
    steps = np.full(200, 1e-3)
    dynamics.leap(steps, steps, np.ones((200, 1)))
    mass = dynamics.mass[:, None]
    size = np.sum(mass * abs(dynamics.v))
    assert size > 1.0
    assert abs(np.sum(mass * dynamics.v, axis=0)).max() < 1e-12 * size
    moved = np.sum(mass * (dynamics.x - start), axis=0) / mass.sum()
    assert abs(moved).max() < 1e-12


def test_pair_that_comes_close_later_is_seen(tissue_of):
    """A tissue squeezed to two thirds: pairs from beyond the lists come within the cut-off."""
    tissue = tissue_of((2, 2), "water")
    twin, dynamics = TissueTwin(tissue), TissueDynamics(tissue, skin=0.5)
    start = dynamics.x
    dynamics.place(start, start * np.array([-1.0, 0.0]))
    steps = np.full(340, 1e-3)
    dynamics.leap(0.0 * steps, steps)
    assert dynamics.counts["list_builds"] > 3
    expected, *_ = twin.evaluate(dynamics.x, dynamics.v)
    assert_near(dynamics.forces(), expected, 1e-9)
    pairs = np.argsort(twin.order)[np.stack(twin.pairs["contact"][:2])]
    before, after = (np.hypot(*(at[pairs[1]] - at[pairs[0]]).T) for at in (start, dynamics.x))
    late = before > tissue.cell.repulsion_cutoff + 2 * 0.5
    assert (late & (after < tissue.cell.repulsion_cutoff)).sum() > 100


def test_lists_only_change_the_cost(tissue_of):
    runs = []
    for skin in (0.3, 4.0):
        dynamics = TissueDynamics(tissue_of((2, 1)), skin=skin)
        steps = np.full(300, 1e-3)
        dynamics.leap(steps, steps)
        runs.append((dynamics.x, dynamics.counts["list_builds"]))
    (x, builds), (y, fewer) = runs
    assert builds > fewer
    np.testing.assert_allclose(x, y, rtol=0, atol=1e-9)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="needs two cores")
def test_number_of_threads_does_not_matter(tissue_of):
    ends = []
    before = numba.get_num_threads()
    try:
        for threads in (1, 2):
            numba.set_num_threads(threads)
            dynamics = TissueDynamics(tissue_of((8, 8)))
            steps = np.full(20, 1e-3)
            dynamics.leap(steps, steps)
            ends.append(dynamics.x)
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*ends)


def test_relaxed_tissue_shrinks_where_its_boundary_is_free(reference):
    """Outer walls bulge; outer rows shrink by about 5 %, the inside by 0.2 to 0.7 %."""
    load_case = LoadCase(width=150.0, height=150.0, watched=(150.0, 75.0))
    conditions = make_conditions(load_case, *reference("printed"))
    tissue = conditions.tissue
    dynamics = held_and_loaded(conditions, TissueSettings())
    x = relax(dynamics, 1e-6)
    assert abs(dynamics.forces() * dynamics.free).max() <= 1e-6
    start = tissue.to_particles(tissue.start)

    def at(point):
        return x[np.linalg.norm(start - np.array(point), axis=1).argmin()]

    row = [at((25.0 * a, 75.0))[0] for a in range(7)]
    strain = np.diff(row) / 25.0 - 1.0
    assert -0.06 < strain[-1] < -0.04
    assert (strain[:5] < -0.002).all()
    assert (strain[:5] > -0.008).all()
    assert at((150.0, 62.5))[0] - at((150.0, 50.0))[0] > 2.0


def test_reference_of_another_cell_is_refused(reference):
    cell, at_rest = reference("printed")
    with pytest.raises(MismatchError, match=r"^reference: it belongs to plant cells"):
        simulate_tissue(LOAD_CASE, replace(cell, viscosity=0.2), reference=at_rest)


def limit_of(cell):
    return stable_step(cell, RveLaw(cell).reference)


def run(cell, **settings):
    """Two by two plant cells pulled down for 2 µs."""
    side = cell.cell_side
    load = LoadCase(
        width=2.0 * side, height=2.0 * side, watched=(2.0 * side, side), duration=2.0,
        body_force=(0.0, -12.5 / side), output_interval=0.5,
    )  # fmt: skip
    return simulate_tissue(load, cell, TissueSettings(**settings), reference=RveLaw(cell).reference)


@pytest.mark.parametrize("preset", ["printed", "water", "apple", "potato"])
def test_presets_keep_the_step_of_two_nanoseconds(preset):
    assert rounded_step(limit_of(CellParameters.preset(preset, fluid="sph"))) == 2e-3


def test_without_damping_the_limit_is_two_over_the_largest_frequency():
    """Nearly that of the walls: a chain's largest is 2 √(k/m), so the limit is √(m/k)."""
    cell = CellParameters.preset("printed")
    undamped = replace(cell, **UNDAMPED)
    reference = replace(RveLaw(cell).reference, fingerprint=undamped.fingerprint)
    found = stable_step(undamped, reference)
    chain = (cell.wall_particle_mass / cell.wall_stiffness) ** 0.5
    assert 0.8 * chain < found < 1.02 * chain


@pytest.mark.slow
@pytest.mark.parametrize(
    "cell",
    [CellParameters.preset("printed", wall_stiffness=stiffness) for stiffness in (4400.0, 6000.0)]
    + [CellParameters.preset(name, fluid="sph") for name in ("apple", "potato")],
    ids=["stiff", "stiffer", "apple", "potato"],
)
def test_plant_cells_get_a_step_that_they_bear(cell):
    done = run(cell)
    energies = done.energies
    assert np.abs(energies["balance"]).max() < 1e-3 * np.abs(energies["load"]).max()
    half = run(cell, micro_step=0.5 * rounded_step(limit_of(cell)))
    assert_near(done.curve.displacement, half.curve.displacement, 1e-3)


def test_a_step_near_the_limit_is_refused_and_the_limit_named():
    """At 0.95 of the limit at rest this run grew to 270,000 µm without an error."""
    cell = CellParameters.preset("printed", wall_stiffness=6000.0)
    limit = limit_of(cell)
    for share in (0.95, 1.02, 2.0):
        with pytest.raises(InputError) as caught:
            run(cell, micro_step=share * limit)
        message = str(caught.value)
        assert message.startswith(f"tissue.micro_step: {share * limit:.4g} µs; at most")
        assert f"the limit of stability at rest is {limit:.4g} µs" in message
        assert "leave it out or take 0.0016" in message
    within = run(cell, micro_step=0.86 * limit)
    assert_near(within.curve.displacement, run(cell).curve.displacement, 1e-3)


RAMPED = LoadCase(
    width=50.0, height=50.0, watched=(50.0, 25.0), body_force=(0.5, -2.0), duration=3.0,
    output_interval=0.25, amplitude=((0.0, 0.0), (0.5, 1.0)),
)  # fmt: skip


@pytest.fixture(scope="module")
def simulate(run_tissue):
    return partial(run_tissue, RAMPED, "printed", skin=0.4, frames=5)


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
    other = with_load(RAMPED, acceleration=(0.5, -1.0))
    with pytest.raises(MismatchError, match=r"resume: .* are not those of the checkpoint"):
        run_tissue(other, "printed", skin=0.4, frames=5, resume=state)
    arrays = state.to_arrays()
    taken = TissueState.from_arrays(arrays | {"frames.displacement": np.empty((0, 1, 2))})
    with pytest.raises(MismatchError, match="resume: keep_frame took the whole fields of"):
        run_tissue(RAMPED, "printed", skin=0.4, frames=5, resume=taken)
    del arrays["relaxed"]
    with pytest.raises(InputError, match="relaxed"):
        TissueState.from_arrays(arrays)
