"""What a run by a cached law says of its cache, in run.json and on the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surrofe2.io.runs import RunRecord


def cache_report(law: Any, *, whole: bool = False) -> dict[str, Any] | None:
    """What a cached law has to report; None of any other law.

    whole: the run is over: audit what waits and time true RVEs for the cost.
    """
    from surrofe2.cache import CachedLaw

    if not isinstance(law, CachedLaw):
        return None
    return law.report() if whole else law.history()


def resume_cache(law: Any, report: Mapping[str, Any]) -> None:
    """Let a cached law go on from what an interrupted run reported."""
    from surrofe2.cache import CachedLaw

    if isinstance(law, CachedLaw):
        law.restore(report)


def cache_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """Sentences on audit, trust and cost of a run, each with whether it is a warning."""
    cache = record.cache
    if cache is None:
        return
    yield f"audit: {audit_sentence(cache)}", False
    for event in cache["trust"]["events"]:
        yield f"cache, step {event['step']}: {event['finding']}", True
    if cache["cost"] is not None:
        yield f"cost: {cache['cost']['sentence']}", not cache["cost"]["pays"]


def audit_sentence(cache: Mapping[str, Any]) -> str:
    """How many answers were audited and how wrong they were."""
    audit, allowed = cache["audit"], float(cache["tolerance"]["absolute"])
    if not audit["audited"]:
        return "none of the cache's answers"
    text = f"{audit['audited']} of {cache['accepted']['hits']} accepted answers"
    if audit["quantiles"]:
        text += (
            f", error {audit['quantiles']['0.99']:.2g} µN/µm at 99 %, {audit['largest']:.2g} worst"
        )
    if allowed == float("inf"):
        return f"{text}; no bound, so no tolerance is held"
    return f"{text}; {audit['violations']} above the tolerance of {allowed:.2g} µN/µm"
