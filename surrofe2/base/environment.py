"""Cores that a process may use, and settings that the command line makes in its own process.

Importing the package and computing stresses change nothing of the process that does it. A program
that is all surrofe2 calls `take_process` before numba is loaded, as the command line does: kernels
then start sooner, and cold solves of RVEs take 7 to 20 % less time.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from pathlib import Path

# Turns for which threads that wait for each other spin. Spinning for long is a fifth faster on idle
# cores and ten times slower where another process wants one.
SPIN = 2000
# The same of a full tissue: its threads meet every 0.1 ms and must not fall asleep in between.
LONG_SPIN = 20000
_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# Numbers of settings in the C library's mallopt.
_TRIM_THRESHOLD = -1
_MMAP_THRESHOLD = -3
_CGROUPS = Path("/sys/fs/cgroup")
# The file that names the control groups of this process.
_OWN = Path("/proc/self/cgroup")

# Whether the process runs surrofe2 and nothing else.
is_taken = False


def take_process(spin: int = SPIN) -> None:
    """Set what suits kernels, for this process and those that it starts.

    What the user has set in the environment stays. Libraries read their variables when they are
    loaded: numba and torch must not be, yet.

    Args:
        spin: see `SPIN`.
    """
    global is_taken
    is_taken = True
    os.environ.setdefault("GOMP_SPINCOUNT", str(spin))
    allowed = cores()
    if allowed < len(os.sched_getaffinity(0)):  # libraries see the cores, and not the quota
        for name in _THREADS:
            os.environ.setdefault(name, str(allowed))
    keep_memory()


def keep_memory() -> None:
    """Have the C library keep memory that is freed.

    Kernels allocate some 0.3 MB per tile and free it again. glibc would give such memory back to
    the system each time, and to get it again, zeroed, costs a cold solve 7 to 20 % of its time.
    """
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):  # not with another C library
        library.mallopt(_MMAP_THRESHOLD, 32 << 20)
        library.mallopt(_TRIM_THRESHOLD, 64 << 20)


def cores() -> int:
    """Return how many cores this process may use, at least 1.

    Those of its affinity, or fewer where the CPU quota of its container or batch job allows less;
    of a quota of 2.5 cores 2, since threads that are out of quota let the others wait.
    """
    bound = len(os.sched_getaffinity(0))
    return max(1, min([bound, *map(int, _quotas())]))


def _quotas() -> Iterator[float]:
    """Yield the CPU quotas of the control groups that this process is in, in cores."""
    try:
        lines = _OWN.read_text(encoding="utf-8").splitlines()
    except OSError:  # no such system
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:
            root = _CGROUPS
            quota_of = _quota_of_version_2
        elif "cpu" in controllers.split(","):
            root = _CGROUPS / "cpu"
            quota_of = _quota_of_version_1
        else:
            continue
        # In a container the path may be that of the host: then only the root is there.
        group = root / path.lstrip("/")
        for folder in (group, *group.parents):
            if folder.is_relative_to(root):
                try:
                    yield quota_of(folder)
                except (OSError, ValueError):  # there is none
                    continue


def _quota_of_version_2(folder: Path) -> float:
    """Return the CPU quota of a control group in cores; a `ValueError` where it has none."""
    quota, period = (folder / "cpu.max").read_text(encoding="ascii").split()
    return int(quota) / int(period)  # "max" is a ValueError


def _quota_of_version_1(folder: Path) -> float:
    """Do what `_quota_of_version_2` does, by the files of version 1."""
    quota = int((folder / "cpu.cfs_quota_us").read_text(encoding="ascii"))
    period = int((folder / "cpu.cfs_period_us").read_text(encoding="ascii"))
    if quota <= 0:
        raise ValueError("no quota")
    return quota / period
