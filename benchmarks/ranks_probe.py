"""One short run of the bar, alone or by all ranks that mpiexec starts of this; prints JSON.

`mpiexec -n 2 python -m benchmarks.ranks_probe`
"""

from __future__ import annotations

import argparse
import json
from time import perf_counter
from typing import Any

import numpy as np

from surrofe2 import CellParameters, LoadCase, MacroSettings, RveLaw, simulate
from surrofe2.ranks.distributed_law import distributed
from surrofe2.ranks.driver import Driver, serve, world
from surrofe2.workflow.laws import use_threads

SIZES = (8, 1024, 65_536, 1_048_576)
"""Bytes of a message."""


def main() -> None:
    """Rank 0 measures, the others serve."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--elements", type=int, default=64)
    parser.add_argument("--duration", type=float, default=1.0, help="µs")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    use_threads(given.threads)
    comm = world()
    if comm is None:
        print(json.dumps(_measured(given, None)))
        return
    echoes = _echoes(comm)
    if comm.rank:
        serve(comm)
        return
    with Driver(comm) as driver:
        found = _measured(given, driver)
    print(json.dumps(found | {"messages_by_size": echoes}))


def _measured(given: argparse.Namespace, driver: Driver | None) -> dict[str, Any]:
    """Seconds of a run after a warm-up, and where they went."""
    law: Any = RveLaw(CellParameters.preset("printed"))
    if driver is not None:
        law = distributed(law, driver)
    elements, settings = (given.elements, given.elements), MacroSettings()
    simulate(LoadCase(duration=given.duration / 20.0, elements=elements), law, settings)
    if driver is not None:
        driver.tasks, driver.seconds = 0, {"computing": 0.0, "messages": 0.0}
    run = simulate(LoadCase(duration=given.duration, elements=elements), law, settings)
    return {
        **run.wall_time,
        "stresses": run.counts["stress_points"] + run.counts["dissipation_points"],
        "calls": run.counts["stress_calls"],
        "steps": run.counts["steps"],
        "last": run.curve.displacement[-1].tolist(),
        "fingerprint": law.cell.fingerprint,
        **({} if driver is None else driver.report()),
    }


def _echoes(comm: Any) -> dict[int, float]:
    """Seconds of a message between ranks 0 and 1 by bytes, half of there and back; the median."""
    found = {}
    for size in SIZES:
        buffer, taken = np.zeros(size, dtype=np.uint8), []
        for _ in range(200):
            began = perf_counter()
            if comm.rank == 0:
                comm.Send(buffer, 1)
                comm.Recv(buffer, 1)
            elif comm.rank == 1:
                comm.Recv(buffer, 0)
                comm.Send(buffer, 0)
            taken.append(0.5 * (perf_counter() - began))
        found[size] = float(np.median(taken))
    return found


if __name__ == "__main__":
    main()
