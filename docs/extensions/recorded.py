"""Commands on a page with what they printed, kept in docs/recorded and checked by a digest.

    ```{recorded}
    surrofe2 run RECIPE --law rve --out out/rve
    ```

shows the command and its output as `python docs/record.py PAGE` last found it. Options: `:file:`
makes the content a file of that name instead; `:language: python` runs it by Python; `:keep:` names
pictures that docs/recorded keeps; `:hide-output:` shows no output; `:fails:` means an
error is what is shown. A page whose commands or recipes
are no longer those of its record is a warning, so `make docs` fails.
"""

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).parents[2]
STORE = ROOT / "docs" / "recorded"
BLOCK = re.compile(r"^```\{recorded\}\n((?::[^\n]*\n)*)\n?(.*?)^```$", re.MULTILINE | re.DOTALL)
NAMED = re.compile(r"[\w./-]+\.(?:toml|py|msh)")
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Block:
    """One recorded block of a page: its options and its text."""

    options: dict[str, str]
    text: str


def blocks_of(page: Path) -> list[Block]:
    """The recorded blocks of a page, in order."""
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return [Block(dict(re.findall(r":([\w-]+): *(.*)", head)), text) for head, text in found]


def digest_of(page: Path) -> str:
    """Of all blocks of a page, and of the files of the project that they name."""
    hashed = hashlib.sha256()
    for block in blocks_of(page):
        hashed.update(json.dumps([block.options, block.text], sort_keys=True).encode())
        for name in sorted(set(NAMED.findall(block.text))):
            if (ROOT / name).is_file():
                hashed.update(name.encode() + (ROOT / name).read_bytes())
    return hashed.hexdigest()


def store_of(page: Path) -> Path:
    """Where the record of a page lies."""
    return STORE / f"{page.stem}.json"


class Recorded(SphinxDirective):
    """A block of commands and what they printed."""

    has_content = True
    option_spec: ClassVar = {
        "file": directives.unchanged,
        "language": directives.unchanged,
        "keep": directives.unchanged,
        "fails": directives.flag,
        "hide-output": directives.flag,
    }

    def run(self) -> list[nodes.Node]:
        """The nodes that stand for it."""
        text = "\n".join(self.content)
        file = self.options.get("file")
        language = self.options.get("language") or ("toml" if file else "sh")
        shown = nodes.literal_block(text, text, language=language)
        if file:
            wrapper = nodes.container("", literal_block=True, classes=["literal-block-wrapper"])
            wrapper += [nodes.caption(file, file), shown]
            return [wrapper]
        said = self._said(text)
        if not said or "hide-output" in self.options:
            return [shown]
        output = nodes.literal_block(said, said, language="none", classes=["recorded-output"])
        return [shown, output]

    def _said(self, text: str) -> str:
        page = Path(self.env.doc2path(self.env.docname))
        store = store_of(page)
        self.env.note_dependency(str(store))
        kept = json.loads(store.read_text(encoding="utf-8")) if store.is_file() else {}
        if kept.get("digest") != digest_of(page):
            place = (self.env.docname, self.lineno)
            logger.warning("not as recorded; python docs/record.py %s", page.name, location=place)
        return kept.get("said", {}).get(text.strip(), "")


def setup(app):
    """What Sphinx calls."""
    app.add_directive("recorded", Recorded)
    return {"parallel_read_safe": True}
