"""The page, all of it in order."""

from __future__ import annotations

import json

from surrofe2.report.comparison_plot import comparison_title
from surrofe2.report.page.html import document, missing, paragraph
from surrofe2.report.page.motion import motion_section
from surrofe2.report.page.origin import (
    event_section,
    origin_section,
    particle_section,
)
from surrofe2.report.page.outcome import cost_section, displacement_section, energy_section
from surrofe2.report.page.seen import Seen
from surrofe2.report.page.trust import audit_section, fallback_section, range_section


def page_of(seen: Seen) -> str:
    """One HTML file that needs nothing else."""
    motion, data = motion_section(seen)
    names = ", ".join(each.name for each in seen.runs)
    title = " ".join(comparison_title([each.run for each in seen.runs]).split())
    begin = [paragraph(title)]
    for run in seen.comparison.runs if seen.comparison else ():
        faster = run.speed_up["wall_time"]
        begin.append(
            paragraph(
                f"{run.name} differs from {seen.runs[0].name} by at most "
                f"{100.0 * run.difference.largest:.2g} % of the largest displacement"
                + (f" and is {faster:.3g} times as fast by itself." if faster else "."),
                "headline",
            )
        )
    begin += [
        missing(f"{each.name}: {each.record.status}; {each.record.error or 'it is not whole'}")
        for each in seen.runs
        if each.record.status != "finished"
    ]
    sections = (
        ("motion", "Motion", "".join(begin) + motion),
        ("displacement", "Displacement", displacement_section(seen)),
        ("cost", "Time and speed-up", cost_section(seen)),
        ("fallback", "Fallbacks", fallback_section(seen)),
        ("audit", "Audits", audit_section(seen)),
        ("range", "Range", range_section(seen)),
        ("energy", "Energies", energy_section(seen)),
        ("cells", "Plant cells", particle_section(seen)),
        ("events", "Events", event_section(seen)),
        ("origin", "Provenance", origin_section(seen)),
    )
    return document(f"surrofe2: {names}", sections, json.dumps({"runs": data}))
