"""Whether this process is one of several MPI ranks, told without loading MPI."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from surrofe2.base.errors import InputError

_SIZES = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "MV2_COMM_WORLD_SIZE")
_RANKS = ("PMI_RANK", "OMPI_COMM_WORLD_RANK", "MV2_COMM_WORLD_RANK", "PMIX_RANK")
_LOCAL_SIZES = ("MPI_LOCALNRANKS", "OMPI_COMM_WORLD_LOCAL_SIZE", "MV2_COMM_WORLD_LOCAL_SIZE")
_WATCH = 'read done || echo "$0" >&2'
"""Says its sentence where its input ends without a line, whoever had the other end."""


def world_size() -> int:
    """How many ranks whoever started this process has started with it; 1 without MPI."""
    known = [os.environ[name] for name in _SIZES if name in os.environ]
    if not known and "PMIX_RANK" in os.environ:
        known = [os.environ.get("SLURM_STEP_NUM_TASKS", "1")]
    return int(known[0]) if known and known[0].isdigit() else 1


def is_first() -> bool:
    """Whether this is rank 0, for what must be done before MPI is loaded."""
    return "0" in [os.environ[name] for name in _RANKS if name in os.environ][:1]


def world() -> Any:
    """The communicator of all ranks; None where this process is alone.

    Raises:
        InputError: there are several, and mpi4py is not installed.
    """
    if world_size() < 2:
        return None
    try:
        from mpi4py import MPI
    except ImportError as error:
        raise InputError(
            f"mpiexec: {world_size()} ranks, but mpi4py cannot be loaded ({error}); "
            "install surrofe2[mpi]"
        ) from None
    if MPI.COMM_WORLD.size != world_size():
        raise InputError(
            f"mpiexec: it started {world_size()} ranks, and mpi4py sees {MPI.COMM_WORLD.size}; "
            "mpi4py must be built for the MPI that mpiexec belongs to"
        )
    return MPI.COMM_WORLD


def own_threads() -> int:
    """Cores for each rank: those that it is bound to, or its share of the machine's."""
    bound, cores = len(os.sched_getaffinity(0)), os.cpu_count() or 1
    local = [os.environ[name] for name in _LOCAL_SIZES if name in os.environ]
    ranks = int(local[0]) if local and bound == cores else 1
    return max(1, bound // ranks)


@contextmanager
def watched(what: str, arguments: Sequence[str]) -> Iterator[None]:
    """Say a sentence even where this process is killed in the block.

    A launcher that loses one rank kills the others, who can say nothing any more. A shell waits
    beside this process and speaks where it ended without a word.

    Args:
        what: is kept; arguments: of the command that goes on.
    """
    again = shlex.join(["surrofe2", *(each for each in arguments if each != "--fresh")])
    sentence = f"error: a rank died; {what}; any number of ranks goes on with: {again}"
    watcher = subprocess.Popen(
        ["/bin/sh", "-c", _WATCH, sentence], stdin=subprocess.PIPE, start_new_session=True
    )
    try:
        yield
    finally:
        watcher.communicate(b"done\n")


def leave() -> None:
    """Take leave of MPI, which takes a rank that ends without for one that was lost."""
    if "mpi4py" in sys.modules:
        from mpi4py import MPI

        MPI.Finalize()
