"""What computed a run, as far as it matters for its wall times and last digits."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path


def describe_platform() -> dict[str, str]:
    """Processor, cores, system and library versions; nothing that identifies the machine."""
    libraries = {name: version(name) for name in ("numpy", "scipy", "numba", "torch")}
    return {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": platform.system(),
        "python": platform.python_version(),
        **libraries,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
