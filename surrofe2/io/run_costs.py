"""What runs cost, and what was made for them before, as their records have it."""

from __future__ import annotations

from surrofe2.costs import NOTHING, Balance, Cost
from surrofe2.io.run_folder import RunRecord


def cost_of(record: RunRecord) -> Cost:
    """What a run cost, but for compilation."""
    wall, cpu = (record.wall_time.get(name, 0.0) for name in ("total", "cpu"))
    processor, cores = (record.platform.get(name, "unknown") for name in ("processor", "cores"))
    return Cost(wall=wall, cpu=cpu, threads=record.threads, machine=f"{processor}, {cores} cores")


def made_for(record: RunRecord) -> Cost | None:
    """What was made for a run, of a surrogate or table that it began with; None: not known."""
    if record.surrogate is None:
        return None if record.law in ("cached", "surrogate") else NOTHING
    costs = record.surrogate.get("cost", {})
    if record.law != "table" and not any(name.startswith("data") for name in costs):
        return None
    return sum(map(Cost.of, costs.values()), start=NOTHING) if costs else None


def balance_of(record: RunRecord, true: RunRecord) -> Balance | None:
    """A run through a cache or a surrogate against a true one; None of other runs."""
    if record.law not in ("cached", "table", "surrogate") or true.law not in ("rve", "tissue"):
        return None
    made = made_for(record)
    wall = None if made is None else made.wall
    return Balance(made=wall, run=cost_of(record).wall, true=cost_of(true).wall)
