"""`mpiexec -n N python -m tests.law_on_ranks`: a law on ranks against the same law on rank 0."""

import sys

import numpy as np
from mpi4py import MPI

from surrofe2 import CellParameters, RveLaw
from surrofe2.base.errors import SimulationError
from surrofe2.cache import CachedLaw, CacheSettings
from surrofe2.ranks import DistributedLaw, Driver, distributed_law, serve
from tests.laws import Learnt, shear_error


def check(laws, F, F_dot, states, **options):
    """Both laws respond and accept alike; their states."""
    here, there = (
        law.respond(F, F_dot, state, **options) for law, state in zip(laws, states, strict=True)
    )
    far = np.abs(here.stress).max()
    np.testing.assert_allclose(there.stress, here.stress, rtol=0.0, atol=1e-9 * far)
    np.testing.assert_array_equal(there.status, here.status)
    assert there.effort["rve_solves"] == here.effort["rve_solves"]
    if here.tangents is not None:
        for name in ("P_by_F", "P_by_F_dot"):
            slopes = getattr(here.tangents, name)
            np.testing.assert_allclose(
                getattr(there.tangents, name), slopes, rtol=0.0, atol=1e-7 * np.abs(slopes).max()
            )
    answers = zip(laws, (here, there), strict=True)
    return [law.accept(F, F_dot, answer).state for law, answer in answers]


def check_states(law, there):
    """States are taken apart, put together and stored as those of one process."""
    random, laws = np.random.default_rng(1), (law, there)
    F = np.eye(2) + 0.03 * random.standard_normal((99, 2, 2))
    F_dot = 1e-3 * random.standard_normal((99, 2, 2))
    some, first = random.integers(0, 99, 57), np.arange(57)
    whole = check(laws, F, F_dot, (None, None), tangents=True)
    part = check(laws, 1.001 * F[some], F_dot[some], [state.take(some) for state in whole])
    F[first], F_dot[first] = 1.001 * F[some], F_dot[some]
    both = zip(whole, part, strict=True)
    mixed = check(laws, F, F_dot, [state.put(first, other) for state, other in both])
    stored = [law.state_to_arrays(state) for law, state in zip(laws, mixed, strict=True)]
    assert [*stored[0], "owner", "ranks"] == list(stored[1])
    again = [law.state_from_arrays(each) for law, each in zip(laws, stored[::-1], strict=True)]
    check(laws, 1.001 * F, F_dot, again)


def check_checkpoint(there):
    """A cached law stores what ranks hold of its points and audits, and carries on from it."""
    learnt = Learnt(shear_error(0.0), shear_error(0.0), outside=lambda F: F[:, 0, 0] > 1.005)
    learnt.initialisation = there.initialisation
    laws = [CachedLaw(learnt, there, CacheSettings(tolerance=np.inf, audit=1.0)) for _ in range(2)]
    F = np.tile(np.eye(2), (40, 1, 1))
    F[::2, 0, 0] = 1.01
    state = laws[0].accept(F, 0.0 * F, laws[0].respond(F, 0.0 * F)).state
    states = state, laws[1].state_from_arrays(laws[0].state_to_arrays(state))
    one, other = (
        law.accept(1.001 * F, 0.0 * F, law.respond(1.001 * F, 0.0 * F, each))
        for law, each in zip(laws, states, strict=True)
    )
    assert len(other.state.on_fallback) == 20
    np.testing.assert_allclose(other.stress, one.stress, rtol=0.0, atol=1e-9)
    reports = [law.report()["audit"] for law in laws]
    assert reports[0]["audited"] == reports[1]["audited"] == 40
    assert abs(reports[0]["largest"] - reports[1]["largest"]) < 1e-9


def check_few_points(driver, there):
    """They go to one rank, the same ones to the same, others to all ranks in the long run."""
    owners = []
    for k in range(20):
        F = np.tile(np.eye(2) + 1e-3 * k, (8, 1, 1))
        one, again = (set(there.respond(F, 0.0 * F).state.owner) for _ in range(2))
        assert len(one) == 1
        assert one == again
        owners += one
    counts = np.bincount(owners, minlength=driver.ranks)
    assert counts.min() >= 3  # seen: 20 loads, up to 3 ranks


def fail(worker):
    raise MemoryError("no room")


def main():
    distributed_law.LEAST, distributed_law.PIECE = 1, 16  # states of 99 points come in pieces
    law = RveLaw(CellParameters.preset("printed"))
    with Driver(MPI.COMM_WORLD) as driver:
        there = DistributedLaw(law, driver)
        check_states(law, there)
        check_checkpoint(there)
        check_few_points(driver, there)
        assert len(driver._worker.states) < 3  # the others were dropped with the next task
        try:
            driver.do(fail, [None, *[()] * (driver.ranks - 1)])
        except SimulationError as error:
            sys.stdout.write(str(error))


if __name__ == "__main__":
    if MPI.COMM_WORLD.rank:
        sys.exit(serve(MPI.COMM_WORLD))
    main()
