"""The launcher of MPI (mpiexec, srun) of this process, if any, seen without loading MPI."""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import suppress

# Environment variable by which every process that a launcher starts works for itself.
ALONE = "SURROFE2_ALONE"
# Seconds that a launcher takes to pass on the last lines of a rank. It ends ranks as soon as it has
# reason to, and what it has not read of their pipes by then is lost.
HEARD = 0.3
# Seconds, at most, that a launcher takes to end its processes, and ranks to come to the same line
# of a command.
ENOUGH = 2.0
_SIZES = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "MV2_COMM_WORLD_SIZE")
_RANKS = ("PMI_RANK", "OMPI_COMM_WORLD_RANK", "MV2_COMM_WORLD_RANK", "PMIX_RANK")


def world_size() -> int:
    """Return how many ranks the launcher has started, this process included; 1 without MPI."""
    if os.environ.get(ALONE):
        return 1
    known = [os.environ[name] for name in _SIZES if name in os.environ]
    if not known and "PMIX_RANK" in os.environ:
        known = [os.environ.get("SLURM_STEP_NUM_TASKS", "1")]
    return int(known[0]) if known and known[0].isdigit() else 1


def rank() -> int:
    """Return the number of this process among the ranks, without MPI; 0 without a launcher."""
    known = [os.environ[name] for name in _RANKS if name in os.environ]
    return int(known[0]) if known and known[0].isdigit() else 0


def pass_on_lines() -> None:
    """Wait until the launcher has passed on what this process has printed."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    time.sleep(HEARD)


def end_job() -> None:
    """End this process so that the launcher ends the other ranks, too, once it is heard.

    Ranks that load MPI wait for all others, and a launcher lets them wait where one has ended with
    an exit code before it came to MPI. So this one asks the launcher, by the message that MPI
    itself would send, to end all; to launchers without such a connection a signal says it.
    """
    pass_on_lines()
    with suppress(KeyError, ValueError, OSError):
        os.write(int(os.environ["PMI_FD"]), b"cmd=abort exitcode=1\n")
        time.sleep(ENOUGH)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.kill(os.getpid(), signal.SIGTERM)
