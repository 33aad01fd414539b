"""What a run folder holds at the end, whatever was run."""

from __future__ import annotations

FILES = ["curve.csv", "energies.csv", "fields.h5", "fields.xdmf", "run.json"]

TISSUE_FILES = sorted([*FILES, "history.csv"])
"""Those of all particles."""

RUN_FILES = sorted([*TISSUE_FILES, "points.h5", "points.xdmf"])
"""Those of finite elements over time."""
