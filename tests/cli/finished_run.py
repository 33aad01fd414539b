"""What a run folder holds at the end, whatever was run."""

from __future__ import annotations

FILES = ["curve.csv", "energies.csv", "fields.h5", "fields.xdmf", "run.json"]

RUN_FILES = sorted([*FILES, "history.csv"])
"""Those of finite elements over time."""
