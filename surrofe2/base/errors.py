"""Errors a user can meet. Each message is one sentence: the field, the value, what is allowed."""

from __future__ import annotations

# Characters of a sentence; of a longer one the middle is left out.
LONGEST = 300
_LONGEST_VALUE = 80
_LONGEST_NAME = 60


class Surrofe2Error(Exception):
    """Base of every error that surrofe2 raises on purpose; the command line prints its one line.

    Attributes:
        faults: the errors of all entries of a recipe at fault, where it is the first of them.
    """

    faults: tuple[Surrofe2Error, ...] = ()

    def __init__(self, sentence: str = "") -> None:
        super().__init__(shortened(sentence))


class InputError(Surrofe2Error, ValueError):
    """An argument, recipe entry or array is not what the call takes.

    Args:
        sentence: all of it; or, with a `problem`, the dotted name of the entry that has it.

    Attributes:
        where: the entry, such as "mesh.width"; empty where it is about none.
        problem: what is wrong with it.
    """

    def __init__(self, sentence: str = "", problem: str = "") -> None:
        if problem:
            self.where = sentence
            self.problem = problem
            super().__init__(f"{shortened(sentence, _LONGEST_NAME)}: {problem}")
        else:
            self.where = ""
            self.problem = sentence
            super().__init__(sentence)

    def within(self, where: str) -> InputError:
        """Return the same error of settings that stand elsewhere: `where` replaces their name."""
        if not self.where or self.where.startswith(where):
            return self
        _, dot, key = self.where.partition(".")
        return InputError(f"{where}{dot}{key}", self.problem)


class FileError(Surrofe2Error, OSError):
    """A file cannot be read, written or recognised."""


class MismatchError(Surrofe2Error, ValueError):
    """Two things that must belong together do not: other cell parameters, another recipe."""


class SimulationError(Surrofe2Error, RuntimeError):
    """A computation could not be carried on; `partial` holds what was computed until then."""

    def __init__(self, message: str, partial: object = None) -> None:
        Exception.__init__(self, message)  # all of it: it quotes nothing of a user's
        self.partial = partial


def shortened(text: str, most: int = LONGEST) -> str:
    """Return beginning and end of a text, where it has more than `most` characters."""
    if len(text) <= most:
        return text
    begin = 2 * most // 3
    end = most - begin - 1  # one sign stands for what is left out
    return f"{text[:begin]}…{text[-end:]}"


def printable(text: str) -> str:
    """Return a text with escapes in place of signs that a terminal obeys or does not show.

    Control characters, escape sequences, marks that change the direction of writing, other
    invisible characters, line breaks and bytes that are no UTF-8 become \\x1b, \\u202e, \\n and so
    on.
    """
    if text.isprintable():
        return text
    return "".join(
        sign if sign.isprintable() else sign.encode("unicode_escape").decode() for sign in text
    )


def quoted(value: object) -> str:
    """Return a value as a sentence quotes it, whatever it is."""
    try:
        return shortened(repr(value), _LONGEST_VALUE)
    except (ValueError, RecursionError):  # an integer of thousands of digits; deep nesting
        return f"a very long {type(value).__name__}"
