"""The page: all sections in order, in one document with its policy."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from html import escape
from importlib.resources import files

from surrofe2.report.comparison_plot import comparison_title
from surrofe2.report.page.html import missing, paragraph
from surrofe2.report.page.motion import motion_section
from surrofe2.report.page.outcome import (
    cost_section,
    displacement_section,
    energy_section,
    event_section,
    origin_section,
    particle_section,
)
from surrofe2.report.page.report_data import ReportData
from surrofe2.report.page.trust import audit_section, fallback_section, range_section


def page_of(seen: ReportData) -> str:
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
                + (f" and is {faster:.3g} times faster by itself." if faster else "."),
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
    return _document(f"surrofe2: {names}", sections, json.dumps({"runs": data}))


def _document(title: str, sections: Sequence[tuple[str, str, str]], data: str) -> str:
    """The whole page.

    Args:
        sections: key, heading and content of each.
        data: JSON for the script.
    """
    style, script = (_beside(f"page.{kind}") for kind in ("css", "js"))
    policy = (
        f"default-src 'none'; img-src data:; style-src {_digest(style)}; "
        f"script-src {_digest(script)}; base-uri 'none'; form-action 'none'"
    )
    links = "".join(f'<li><a href="#{key}">{escape(name)}</a></li>' for key, name, _ in sections)
    content = "".join(each for *_, each in sections)
    # A JSON string has no "<" that could end the element early.
    safe = data.replace("<", "\\u003c")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{style}</style></head>\n<body>\n"
        f'<header><h1>{escape(title)}</h1><nav aria-label="Sections"><ul>{links}</ul></nav>'
        f"</header>\n<main>{content}</main>\n"
        f'<script type="application/json" id="data">{safe}</script>\n'
        f"<script>{script}</script>\n</body></html>\n"
    )


def _beside(name: str) -> str:
    return files("surrofe2.report.page").joinpath(name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return f"'sha256-{digest}'"
