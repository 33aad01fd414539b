"""Output that nobody can take, as on a full disk or in a closed pipe, ends no work: it is noted."""

from __future__ import annotations

import errno
import io
import os
import sys


class _Noting(io.FileIO):
    """A descriptor whose first error of writing is kept, and what follows it is lost."""

    error: OSError | None = None

    def write(self, content: bytes) -> int:  # type: ignore[override]
        """Write; how much was taken."""
        try:
            return super().write(content)
        except OSError as error:
            self.error = self.error or error
            return len(content)


_raw: dict[str, _Noting] = {}


def note_errors() -> None:
    """From now on stdout and stderr never fail; what a terminal has no sign for becomes "?"."""
    for name, stream in (("stdout", sys.stdout), ("stderr", sys.stderr)):
        if isinstance(stream, io.TextIOWrapper):
            stream.flush()
            _raw[name] = _Noting(stream.fileno(), "w", closefd=False)
            heard = io.TextIOWrapper(
                io.BufferedWriter(_raw[name]),  # type: ignore[type-var]
                encoding=stream.encoding,
                errors="replace",
                line_buffering=stream.line_buffering,
            )
            setattr(sys, name, heard)


def leave(code: int) -> None:
    """End the process without taking its objects apart; 1 in the place of 0 if words were lost."""
    for name, stream in (("stdout", sys.stdout), ("stderr", sys.stderr)):
        if stream is not None:
            stream.flush()
        error = _raw[name].error if name in _raw else None
        if error is not None:
            code = code or 1
            if error.errno != errno.EPIPE:  # whoever listened has heard enough
                sys.stderr.write(f"error: {name}: {error.strerror}\n")
    os._exit(code)
