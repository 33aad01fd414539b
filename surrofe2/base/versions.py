"""Versions and machine, as records of runs and reports of issues state them."""

from __future__ import annotations

import os
import platform
import re
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

# Libraries whose versions may change the numbers of a run.
IN_RECORDS = ("numpy", "scipy", "numba", "torch")


def describe_platform() -> dict[str, str]:
    """Return processor, cores, system and library versions; nothing that identifies the machine."""
    libraries = {}
    for name in IN_RECORDS:
        with suppress(PackageNotFoundError):  # runs do without torch
            libraries[name] = version(name)
    return {
        "processor": _processor(),
        "cores": str(os.cpu_count()),
        "system": platform.system(),
        "python": platform.python_version(),
        **libraries,
    }


def report_versions() -> str:
    """Write versions of surrofe2, Python, system and dependencies, cores and threads, for an issue.

    Packages of extras are listed where they are installed. Nothing identifies the machine or its
    user.
    """
    import numba  # late: a short command does without

    threads = f"{numba.get_num_threads()} of {len(os.sched_getaffinity(0))} usable cores"
    rows = {
        "surrofe2": version("surrofe2"),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": f"{platform.system()} {platform.release()}, {' '.join(platform.libc_ver())}",
        "processor": f"{_processor()}, {os.cpu_count()} cores",
        "threads": threads,
        **_dependencies(),
    }
    for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS"):
        if name in os.environ:
            rows[name] = os.environ[name]
    width = max(map(len, rows))
    return "\n".join(f"{name:{width}}  {value}" for name, value in rows.items())


def _dependencies() -> dict[str, str]:
    """Return the versions of what the package requires by name, and of its extras if installed."""
    versions = {}
    for requirement in requires("surrofe2") or ():
        name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        is_extra = "extra ==" in requirement
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            if not is_extra:
                versions[name] = "not installed"
    return versions


def _processor() -> str:
    """Return the processor's name, or its architecture where the system does not tell the name."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.machine()
