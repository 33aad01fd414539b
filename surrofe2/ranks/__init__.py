"""RVEs on several MPI ranks; rank 0 has the time loop.

In reading order: `driver` (one task at a time for all ranks) and `distributed_law` (the stress law
whose points they share).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.ranks.distributed_law import DistributedLaw
    from surrofe2.ranks.driver import Driver, serve

__getattr__, __dir__ = public_names(__name__)
