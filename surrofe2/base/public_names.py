"""Public names of a package, each imported from its module when it is first asked for.

A package lists its names once, as imports under TYPE_CHECKING: type checkers follow them, Python
skips them, and `public_names` reads them. So a use of one name loads one module.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


def public_names(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Make `__getattr__` and `__dir__` of a package; `__all__` is among its attributes."""

    @cache
    def homes() -> dict[str, str]:
        """Return the module of each public name."""
        source = Path(str(sys.modules[package].__file__)).read_text(encoding="utf-8")
        return {
            alias.name: str(node.module)
            for block in ast.parse(source).body
            if isinstance(block, ast.If)
            for node in block.body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }

    def get(name: str) -> Any:
        """Import and return a public name."""
        if name == "__all__":
            return names()
        if name.startswith("_") or name not in homes():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(homes()[name]), name)

    def names() -> list[str]:
        """Return the public names in order."""
        return sorted(homes())

    return get, names
