"""Tables of keys have a class of their own, by which a phone shows a row as a small paragraph."""

from docutils import nodes

PAGE = "docs/recipe"


def mark(app, doctree):
    """Give each table of the page of keys the class."""
    if app.env.docname == PAGE:
        for table in doctree.findall(nodes.table):
            table["classes"].append("keys")


def setup(app):
    """What Sphinx calls."""
    app.connect("doctree-read", mark)
    return {"parallel_read_safe": True}
