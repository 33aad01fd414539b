"""Any law of the package with its parts shared by the ranks of a crew."""

from __future__ import annotations

from typing import Any

from surrofe2.cache.cached_law import CachedLaw
from surrofe2.errors import InputError
from surrofe2.ranks.crew import Crew, crew_at_work
from surrofe2.ranks.distributed_law import DistributedLaw
from surrofe2.ranks.distributed_surrogate import DistributedSurrogate
from surrofe2.regional_law import RegionalLaw
from surrofe2.rve.rve_law import RveLaw
from surrofe2.stress_law import StressLaw
from surrofe2.surrogate.surrogate_law import SurrogateLaw


def distributed(law: StressLaw, crew: Crew) -> Any:
    """The same law whose RVEs and lookups all ranks share.

    What a cached law decides and counts stays on rank 0, as one law for all points: its audits are
    the same by any number of ranks.

    Raises:
        InputError: it is none of ours.
    """
    match law:
        case RveLaw():
            return DistributedLaw(law, crew)
        case SurrogateLaw():
            return DistributedSurrogate(law, crew)
        case CachedLaw(surrogate=SurrogateLaw() as surrogate, fallback=RveLaw() as fallback):
            parts = DistributedSurrogate(surrogate, crew), DistributedLaw(fallback, crew)
            return CachedLaw(*parts, law.settings, law.on_true_answer)
        case RegionalLaw():
            laws = {name: distributed(each, crew) for name, each in law.laws.items()}
            return RegionalLaw(laws, law.points)
    raise InputError(
        f"law: {type(law).__name__}; it must be an RveLaw, a SurrogateLaw, a CachedLaw of both or "
        "a RegionalLaw of these"
    )


def shared(law: Any) -> Any:
    """The law as the crew of this process has it, if there is one; else itself."""
    crew = crew_at_work()
    return law if crew is None else distributed(law, crew)


def own_part(law: Any) -> Any:
    """The law of rank 0 behind a distributed one; else itself."""
    return law.law if isinstance(law, DistributedLaw | DistributedSurrogate) else law
