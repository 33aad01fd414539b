r"""Each `\tag{…}` of the theory is an anchor, and its number in text, as "(69)", leads there."""

import re
from pathlib import Path

from docutils import nodes

THEORY = "docs/theory"
PAGES = (
    THEORY,
    "docs/explanation/initialisations",
    "docs/explanation/cache",
    "docs/validation/paper",
    "docs/validation/thin",
)
TAG = re.compile(r"\\tag\{([^}]+)\}")
NAMED = re.compile(r"\((A?\d{1,2}b?)(?:(?:–|, )\d{1,2}b?)?\)")
NO_TEXT = (nodes.literal, nodes.literal_block, nodes.reference, nodes.math, nodes.title)


def numbers_of(tag: str) -> list[str]:
    """The numbers that a tag stands for: "65–67" has three."""
    first, dash, last = tag.partition("–")
    return [str(k) for k in range(int(first), int(last) + 1)] if dash else tag.split(", ")


def anchor_of(number: str) -> str:
    """Where an equation is on the page."""
    return f"equation-{number.lower()}"


def add_anchors(app, doctree):
    """An anchor at every equation of the theory that has a number."""
    if app.env.docname == THEORY:
        for node in doctree.findall(nodes.math_block):
            for tag in TAG.findall(node.astext()):
                node["ids"] += [anchor_of(number) for number in numbers_of(tag)]


def add_links(app, doctree, docname):
    """A link at every number in parentheses that an equation has."""
    if docname not in PAGES:
        return
    page = "" if docname == THEORY else app.builder.get_relative_uri(docname, THEORY)
    for text in list(doctree.findall(nodes.Text)):
        if not isinstance(text.parent, NO_TEXT):
            made = linked(str(text), page, app.env.equation_numbers)
            if len(made) > 1:
                text.parent.replace(text, made)


def linked(text: str, page: str, numbers: set[str]) -> list[nodes.Node]:
    """A text with its links."""
    made: list[nodes.Node] = []
    end = 0
    for found in NAMED.finditer(text):
        if found[1] in numbers:
            uri = f"{page}#{anchor_of(found[1])}"
            link = nodes.reference("", found[0], internal=True, refuri=uri)
            made += [nodes.Text(text[end : found.start()]), link]
            end = found.end()
    return [*made, nodes.Text(text[end:])]


def read_numbers(app):
    """All numbers of the theory."""
    tags = TAG.findall((Path(app.srcdir) / f"{THEORY}.md").read_text(encoding="utf-8"))
    app.env.equation_numbers = {number for tag in tags for number in numbers_of(tag)}


def setup(app):
    """What Sphinx calls."""
    app.connect("builder-inited", read_numbers)
    app.connect("doctree-read", add_anchors)
    app.connect("doctree-resolved", add_links)
    return {"parallel_read_safe": True}
