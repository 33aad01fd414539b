"""RVEs on several MPI ranks; rank 0 has the time loop.

In reading order: `driver` finds out whether there are ranks, and is how rank 0 sends one task at a
time to all of them and collects their results; `distributed_law` is the stress law whose points the
ranks share.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from surrofe2.base.public_names import public_names

if TYPE_CHECKING:
    from surrofe2.ranks.distributed_law import DistributedLaw, distributed
    from surrofe2.ranks.driver import Driver, serve

__getattr__, __dir__ = public_names(__name__)
