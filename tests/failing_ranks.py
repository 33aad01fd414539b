"""`mpiexec -n 2 python -m tests.failing_ranks HOW`: rank 1 fails, or never answers;
or all work until a signal comes."""

import os
import sys
import time

from mpi4py import MPI

from surrofe2.base import interruption
from surrofe2.ranks import Driver, serve
from surrofe2.ranks import driver as drivers

HOW = sys.argv[1]


def arrive(how):
    """What a task becomes on the rank that receives it."""
    if how == "hang" or (MPI.COMM_WORLD.rank == 0) != (HOW == "another version"):
        return how
    if how == "exit":
        sys.exit(0)
    raise AttributeError("no such function")


class Identity:
    """What a rank of another version is known by, which rank 0 cannot read."""

    def __reduce__(self):
        return arrive, ("raise",)


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


def pid(worker):
    time.sleep(0.05)
    return os.getpid()


def wait(driver):
    """Work until a signal comes; print the number of the other process, then what interrupted."""
    try:
        _, other = driver.do(pid, [(), ()])
        sys.stdout.write(f"{other}\n")
        sys.stdout.flush()
        while True:
            driver.do(pid, [(), ()])
    except KeyboardInterrupt:
        sys.stdout.write(f"{interruption.cause()}\n")
        interruption.end_work()
    return 0


def main(how):
    if how == "another version" and MPI.COMM_WORLD.rank:
        drivers._identity = lambda arguments: Identity()
    interruption.watch()
    interruption.begin_work()
    if MPI.COMM_WORLD.rank:
        code = serve(MPI.COMM_WORLD)
        interruption.end_work()
        return code
    with Driver(MPI.COMM_WORLD) as driver:
        sys.stdout.write(f"{os.getpid()}\n")
        sys.stdout.flush()
        if how == "wait":
            return wait(driver)
        driver.do(work, [None, (how if how == "exit in a task" else Task(how),)])
    return 0


if __name__ == "__main__":
    sys.exit(main(HOW))
