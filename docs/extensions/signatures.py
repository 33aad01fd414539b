"""Signatures as the source writes them: `Array` for an array of numbers, names without modules.

Sphinx resolves `Array` to the type that it stands for. Its `autodoc_type_aliases` prevents that in
most places; the rest is done here.
"""

import inspect
import re

from sphinx.util.inspect import TypeAliasForwardRef

ARRAY = re.compile(
    r"~?numpy\.ndarray\[tuple\[~?typing\.Any, \.\.\.\], ~?numpy\.dtype\[(?P<type>[^\[\]]*)\]\]"
)
NAMES = {"numpy.float64": "Array", "numpy.int64": "Index", "numpy.bool": "Flags"}
"""The package's names of arrays, from `surrofe2.base.arrays`, by the type of an entry."""


def short(text: str) -> str:
    """A signature with the package's names of arrays, and with `...` for a default that is made."""
    return ARRAY.sub(name_of, text).replace("<factory>", "...")


def name_of(array: re.Match[str]) -> str:
    """The name of an array type."""
    entry = array["type"].removeprefix("~")
    if entry in NAMES:
        return NAMES[entry]
    plain = re.fullmatch(r"numpy\.(\w+)", entry)
    return f"NDArray[{plain[1]}]" if plain else "NDArray"


def process(app, what, name, obj, options, signature, result):
    """What Sphinx calls for the signature of each name."""
    if inspect.isclass(obj) and getattr(obj, "_is_protocol", False):
        return "", None  # nobody calls a protocol
    return signature and short(signature), result and short(result)


def setup(app):
    """What Sphinx calls."""
    # properties have no event, and an alias within their type shows as this class does
    TypeAliasForwardRef.__repr__ = lambda alias: alias.name
    app.connect("autodoc-process-signature", process)
    return {"parallel_read_safe": True}
