"""Errors a user can meet. Each message is one sentence: the field, the value, what is allowed."""


class Surrofe2Error(Exception):
    """Base of every error that surrofe2 raises on purpose; the command line prints its one line."""


class InputError(Surrofe2Error, ValueError):
    """An argument, recipe entry or array is not what the call takes."""


class FileError(Surrofe2Error, OSError):
    """A file cannot be read, written or recognised."""


class MismatchError(Surrofe2Error, ValueError):
    """Two things that must belong together do not: other cell parameters, another recipe."""


class SimulationError(Surrofe2Error, RuntimeError):
    """A computation could not be carried on; `partial` holds what was computed until then."""

    def __init__(self, message: str, partial: object = None) -> None:
        super().__init__(message)
        self.partial = partial
