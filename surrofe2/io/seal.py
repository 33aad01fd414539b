"""A file proves itself: somewhere in it stands the SHA-256 of the whole file.

The digest is of the file with zeros in the place of the digest itself, whatever the format: it
follows the word `SEAL` in an attribute, a JSON entry or a header. Any changed byte is seen.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from surrofe2.errors import FileError

SEAL = "sha256_of_this_file"
NO_DIGEST = "0" * 64
"""What stands in a file before it is sealed."""
_WORD = SEAL.encode()
_DIGEST = re.compile(rb"(?<=[\"\0])" + _WORD + rb"\W{1,12}([0-9a-f]{64})")


def sealed(content: bytes) -> bytes:
    """`content` with its digest in the place of `NO_DIGEST`, which stands in it once."""
    begin, end = _place(content)
    if content[begin:end] != NO_DIGEST.encode():
        raise ValueError("no place for the digest")
    digest = hashlib.sha256(content).hexdigest().encode()
    return b"".join((content[:begin], digest, content[end:]))


def check_seal(path: Path, content: bytes) -> None:
    """Refuse content that is not what was sealed.

    Raises:
        FileError: there is no digest, or it is that of other content.
    """
    try:
        begin, end = _place(content)
    except ValueError:
        raise FileError(f"{path}: no SHA-256 in it; it is damaged, foreign or older") from None
    digest = hashlib.sha256(content[:begin])
    digest.update(NO_DIGEST.encode())
    digest.update(memoryview(content)[end:])
    if digest.hexdigest().encode() != content[begin:end]:
        raise FileError(f"{path}: damaged, or changed since it was written: see its SHA-256")


def _place(content: bytes) -> tuple[int, int]:
    """Where the digest stands."""
    found, at = [], content.find(_WORD)  # 50 times as fast as to let the pattern search
    while at >= 0:
        match = _DIGEST.match(content, at)
        found += [match.span(1)] if match else []
        at = content.find(_WORD, at + 1)
    if len(found) != 1:
        raise ValueError(f"{len(found)} digests instead of one")
    return found[0]
