"""Work for processes: it has to be in a module that they can import."""

from __future__ import annotations

import os
import signal
from pathlib import Path


def squares(first: int, count: int) -> list[int]:
    return [k * k for k in range(first, first + count)]


def squares_or_death(folder: str, deaths: int, first: int, count: int) -> list[int]:
    """Squares; the process that is given 20 among them dies, `deaths` times."""
    if first <= 20 < first + count:
        died = len(list(Path(folder).iterdir()))
        if died < deaths:
            (Path(folder) / str(died)).touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return squares(first, count)
