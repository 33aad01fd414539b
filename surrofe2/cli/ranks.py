"""A command that mpiexec started several times: rank 0 carries it out, the others work for it."""

from __future__ import annotations

import atexit
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import typer

from surrofe2.ranks.driver import Driver, serve
from surrofe2.ranks.world import is_first, leave, own_threads, watched, world, world_size
from surrofe2.workflow.laws import use_threads


@contextmanager
def all_ranks(threads: int | None, what: str) -> Iterator[int | None]:
    """The threads of each rank, in a block that rank 0 alone enters; without ranks what was given.

    Args:
        what: is kept, for the sentence that is said where a rank dies.

    Raises:
        Exit: here and on every other rank, when rank 0 is done.
    """
    if world_size() < 2:
        yield threads
        return
    threads = threads or own_threads()
    use_threads(threads)
    with watched(what, sys.argv[1:]) if is_first() else nullcontext():
        comm = world()
        atexit.register(leave)  # when all is said: a launcher may not listen any longer
        if comm.rank:
            raise typer.Exit(serve(comm))
        with Driver(comm):
            yield threads
