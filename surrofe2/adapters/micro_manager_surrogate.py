"""The surrogate as a micro simulation of preCICE's Micro Manager, see `micro_manager`.

One instance serves all points: give it the stateless flag.
"""

from __future__ import annotations

from surrofe2.adapters.micro_manager import PointSimulation, the_surrogate


class MicroSimulation(PointSimulation):
    """The surrogate at any point; where it has no data a point fails, whatever the tolerance."""

    def __init__(self, sim_id: int) -> None:
        super().__init__(sim_id, the_surrogate())
