"""The event log of a run: one decision of a cached law a line, as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from surrofe2.io.files import plain, write_text

EVENTS = "events.jsonl"


def write_events(folder: Path, decisions: Iterable[Mapping[str, Any]]) -> None:
    """Write events.jsonl whole; run.json carries its SHA-256."""
    lines = [json.dumps(plain(each), ensure_ascii=False) for each in decisions]
    write_text(folder / EVENTS, "".join(f"{line}\n" for line in lines))
