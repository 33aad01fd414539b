"""`mpiexec -n 2 python -m tests.failing_ranks HOW`: rank 1 fails, or never answers."""

import os
import sys
import time

from mpi4py import MPI

from surrofe2.base import interruption
from surrofe2.ranks import Driver, serve


def arrive(how):
    """What a task becomes on the rank that receives it."""
    if MPI.COMM_WORLD.rank == 0 or how == "hang":
        return how
    if how == "exit":
        sys.exit(0)
    raise AttributeError("no such function")


class Task:
    def __init__(self, how):
        self.how = how

    def __reduce__(self):
        return arrive, (self.how,)


def work(worker, how):
    if how == "hang":
        time.sleep(600)
    if how == "exit in a task":
        sys.exit(0)


def main(how):
    interruption.watch()
    interruption.begin_work()
    if MPI.COMM_WORLD.rank:
        return serve(MPI.COMM_WORLD)
    with Driver(MPI.COMM_WORLD) as driver:
        sys.stdout.write(f"{os.getpid()}\n")
        sys.stdout.flush()
        driver.do(work, [None, (how if how == "exit in a task" else Task(how),)])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
