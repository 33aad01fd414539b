"""Where a run comes from: plant cells, events, settings, provenance."""

from __future__ import annotations

import json
import shlex
from typing import Any

from surrofe2.report.page.html import figure, folded, image, missing, paragraph, section, table
from surrofe2.report.page.seen import Seen, SeenRun
from surrofe2.store.store import flat

_MOST_EVENTS = 200


def particle_section(seen: Seen) -> str:
    """The plant cells that `surrofe2 zoom` looked into."""
    figures = [
        figure(
            image(png, "particles of a plant cell at six times", "png"),
            f"{each.name}, {name}: the plant cell there, walls by stretch and fluid by turgor",
        )
        for each in seen.runs
        for name, png in each.particles.items()
    ]
    if not figures:
        folder = shlex.quote(str(seen.runs[0].run.folder))
        figures = [
            missing(
                "No look into the plant cells in the folders; make one with: "
                f"surrofe2 zoom {folder} --point X,Y"
            )
        ]
    return section("cells", "Plant cells", figures)


def event_section(seen: Seen) -> str:
    """The events of all runs, the last ones where there are many."""
    parts = []
    for each in seen.runs:
        if not each.events:
            parts.append(missing(f"{each.name}: no log of events in its folder."))
            continue
        shown = each.events[-_MOST_EVENTS:]
        keys = list(dict.fromkeys(key for event in shown for key in event))
        rows = [[_short(event.get(key, "")) for key in keys] for event in shown]
        left = len(each.events) - len(shown)
        if left:
            parts.append(paragraph(f"{each.name}: the last {len(shown)} of {len(each.events)}."))
        listed = f'<div class="words">{table(keys, rows)}</div>'
        parts.append(folded(f"{each.name}: {len(each.events)} events", listed))
    return section("events", "Events", parts)


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def origin_section(seen: Seen) -> str:
    """Settings, by what and when each run was made, and the digests of its files."""
    names = [each.name for each in seen.runs]
    recipes = [flat(each.record.recipe) for each in seen.runs]
    keys = list(dict.fromkeys(key for recipe in recipes for key in recipe))
    own = [[key, *(_short(recipe.get(key, "–")) for recipe in recipes)] for key in keys]
    apart = [row for row in own if len(set(row[1:])) > 1]
    made = {each.name: _provenance(each) for each in seen.runs}
    entries = list(dict.fromkeys(key for of in made.values() for key in of))
    rows = [[key, *(made[name].get(key, "–") for name in names)] for key in entries]
    parts = [f'<div class="words">{table(["", *names], rows)}</div>']
    if len(names) > 1:
        same = paragraph("All entries of the recipe are the same in all runs.")
        differ = f'<div class="words">{table(["entry that differs", *names], apart)}</div>'
        parts.append(differ if apart else same)
    whole = [row if row in apart else row[:2] for row in own]
    parts.append(
        folded(
            f"The whole recipe: {len(own)} entries",
            f'<div class="words">{table(["entry", "value"], whole)}</div>',
        )
    )
    return section("origin", "Configuration and provenance", parts)


def _provenance(run: SeenRun) -> dict[str, str]:
    record = run.record
    law = {"law": record.law, "initialisation": record.initialisation, "solver": record.solver}
    mesh = {
        key: record.problem[key] for key in ("elements", "nodes", "points") if key in record.problem
    }
    surrogate = {"surrogate": (record.surrogate or {}).get("fingerprint", "–")}
    counts = {name.replace("_", " "): n for name, n in record.counts.items()}
    found: dict[str, Any] = {
        "status": record.status,
        **({"error": record.error} if record.error else {}),
        **law,
        "plant cell": record.cell_fingerprint,
        **surrogate,
        **mesh,
        "seconds": record.wall_time.get("total", "–"),
        "seconds of all threads": record.wall_time.get("cpu", "–"),
        "threads": record.threads,
        **counts,
        "surrofe2": record.package_version,
        "made": record.created,
        **record.platform,
        **{f"SHA-256 of {name}": value[:16] for name, value in record.files.items()},
    }
    return {key: _short(value) for key, value in found.items()}
