"""Seconds of what was made for a run before it, and its balance, as records have them."""

from __future__ import annotations

from surrofe2.costs import Balance
from surrofe2.io.run_folder import RunRecord


def made_for(record: RunRecord) -> float | None:
    """Seconds of what was made for a run, a surrogate or a table to begin with; None: not known."""
    if record.surrogate is None:
        return None if record.law in ("cached", "surrogate") else 0.0
    seconds = record.surrogate.get("seconds", {})
    if record.law != "table" and not any(name.startswith("data") for name in seconds):
        return None
    return float(sum(seconds.values())) if seconds else None


def balance_of(record: RunRecord, true: RunRecord) -> Balance | None:
    """A run through a cache or a surrogate against one by RVEs; None of other runs."""
    if record.law not in ("cached", "table", "surrogate") or true.law not in ("rve", "tissue"):
        return None
    run, reference = (each.wall_time.get("total", 0.0) for each in (record, true))
    return Balance(made=made_for(record), run=run, true=reference)
