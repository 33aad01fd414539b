"""A run of the full tissue in a process of its own: `python -m benchmarks.tissue_probe`; JSON."""

from __future__ import annotations

import argparse
import json


def main() -> None:
    """Run the bar of so many plant cells a side; where the step is refused or breaks, say why."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--preset", required=True)
    parser.add_argument("--cells", type=int, required=True)
    parser.add_argument("--duration", type=float, required=True)
    parser.add_argument("--micro-step", type=float, required=True)
    given = parser.parse_args()

    from surrofe2 import CellParameters, LoadCase, RveLaw
    from surrofe2.base.errors import InputError, SimulationError
    from surrofe2.tissue import TissueDynamics, TissueSettings, make_tissue, simulate_tissue

    side = 25.0 * given.cells
    load = LoadCase(width=side, height=side, watched=(side, 0.5 * side), duration=given.duration)
    cell = CellParameters.preset(given.preset)
    reference = RveLaw(cell).reference
    tissue = make_tissue(cell, reference, (given.cells, given.cells))
    TissueDynamics(tissue).elastic_energy()  # compiles
    settings = TissueSettings(micro_step=given.micro_step, frames=2)
    try:
        done = simulate_tissue(load, cell, settings, reference=reference)
    except (InputError, SimulationError, FloatingPointError) as error:
        print(json.dumps({"failure": str(error)}))
        return
    print(
        json.dumps(
            {
                "failure": None,
                "run": done.wall_time["run"],
                "total": done.wall_time["total"],
                "t": done.curve.t.tolist(),
                "displacement": done.curve.displacement.tolist(),
            }
        )
    )


if __name__ == "__main__":
    main()
