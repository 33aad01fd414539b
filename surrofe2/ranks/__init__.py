"""A stress law whose points are dealt to persistent MPI ranks; rank 0 has the time loop.

In reading order: `world` finds out whether there are ranks; `dealing` cuts points into blocks;
`crew` is how rank 0 and the others work on one task at a time; `tasks` are what they do;
`rank_states` stands on rank 0 for warm starts that stay where they are; `crew_law` is a law that
every rank has, `distributed_law` and `distributed_surrogate` are the two; `shared` makes them of
others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.ranks.crew import Crew, serve
    from surrofe2.ranks.distributed_law import DistributedLaw
    from surrofe2.ranks.shared import distributed

__getattr__, __dir__ = public_names(__name__)
