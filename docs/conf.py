"""The documentation site: `make docs` builds it into out/site.

The source folder is the project's root, so that links between pages lead to the same files here and
in a view of the repository.
"""

import os
import sys
from importlib import metadata
from pathlib import Path
from urllib.parse import quote

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "surrofe2"
author = metadata.metadata("surrofe2")["Author"]
version = release = metadata.version("surrofe2")
root_doc = "docs/index"
include_patterns = ["docs/**", "examples/*.md", "data/README.md", "*.md"]
exclude_patterns = [".*", "out", "surrofe2", "tests", "benchmarks", "build"]

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx_design",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "commands",
    "docstrings",
    "equations",
    "keys",
    "signatures",
]
# Links to other packages need their lists of names from the network, and a build without one would
# end in warnings. Read the Docs has it; elsewhere these names are plain text.
if os.environ.get("READTHEDOCS"):
    extensions.append("sphinx.ext.intersphinx")
intersphinx_mapping = {
    "python": ("https://docs.python.org/3", None),
    "numpy": ("https://numpy.org/doc/stable", None),
    "scipy": ("https://docs.scipy.org/doc/scipy", None),
    "skfem": ("https://scikit-fem.readthedocs.io/en/latest", None),
}
suppress_warnings = ["mystnb.unknown_mime_type", "config.cache"]

myst_enable_extensions = [
    "attrs_inline",
    "colon_fence",
    "deflist",
    "dollarmath",
    "fieldlist",
    "substitution",
]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
myst_dmath_double_inline = True
# Binder builds the repository by the files in .binder; its address is that of the package.
_ADDRESSES = dict(url.split(", ") for url in metadata.metadata("surrofe2").get_all("Project-URL"))
_BINDER = "https://mybinder.org/v2/git/{}/HEAD?urlpath=lab/tree/docs/notebooks"
myst_substitutions = {
    "binder": f"[open them on Binder]({_BINDER.format(quote(_ADDRESSES['Source'], safe=''))})"
}
nb_execution_mode = "off"  # notebooks keep what they printed; docs/record.py runs them

autodoc_typehints_format = "short"
# Signatures have the package's names of arrays, and defaults as its source has them.
autodoc_type_aliases = {name: name for name in ("Array", "Flags", "Index")}
autodoc_preserve_defaults = True
maximum_signature_line_length = 88
autodoc_member_order = "bysource"
autosummary_generate = False
default_role = "code"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "pydata_sphinx_theme"
html_title = "surrofe2"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "logo": {"text": "surrofe2"},
    "navbar_align": "left",
    "show_prev_next": True,
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 6,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
    "pygments_dark_style": "github-dark",
}
html_sidebars = {"docs/index": []}
copyright = f"{author}, BSD-3-Clause"

# MathJax from its package, so that the site needs no network.
mathjax_path = "mathjax/tex-chtml.js"
mathjax3_config = {"chtml": {"displayAlign": "center"}, "tex": {"tags": "none"}}
_MATHJAX = (
    "static/mathjax/tex-chtml.js",
    "static/mathjax/output/chtml/fonts/woff-v2/",
    "static/mathjax/input/tex/extensions/boldsymbol.js",
)

_FRONT = """<!doctype html><meta charset="utf-8"><title>surrofe2</title>
<meta http-equiv="refresh" content="0; url=docs/index.html"><a href="docs/index.html">surrofe2</a>
"""


def finish(app, error):
    """MathJax and its fonts, and a front door at the root."""
    if error is not None or app.builder.format != "html":
        return
    out = Path(app.outdir)
    (out / "index.html").write_text(_FRONT, encoding="utf-8")
    for file in metadata.files("sphinx-mathjax-offline") or ():
        name = file.as_posix()
        if any(part in name for part in _MATHJAX):
            target = out / "_static" / name.split("/static/")[1]
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(file.read_binary())


def setup(app):
    """What Sphinx calls."""
    app.connect("build-finished", finish)
