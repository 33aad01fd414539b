"""Runs what pages and notebooks show and writes what it printed: `python docs/record.py [PAGE …]`.

A page has a block of code with its output between two comments:

    <!-- recorded: OPTIONS -->
    ```sh
    surrofe2 run RECIPE --law rve --out out/rve
    ```

    ```text
    What it printed.
    ```
    <!-- end -->

The language is `sh`, `python` or `toml`. Options, separated by semicolons: `file NAME` writes the
code to a file and runs nothing; `keep PICTURES` copies pictures to docs/recorded; `fails` means
that an error is what is shown. The blocks of a page run in order in one folder with copies of data/
and examples/. The last line of the page has a digest of its blocks and of the recipes, scripts and
meshes that they name: where it differs, the page has to be recorded again, and tests say so.

Notebooks run in place; docs/conf.py has their settings.
"""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent
STORE = DOCS / "recorded"
BLOCK = re.compile(
    r"^<!-- recorded(?:: (?P<options>[^\n]*))? -->\n"
    r"```(?P<language>sh|python|toml)\n(?P<code>.*?)^```\n"
    r"(?:\n```text\n(?P<output>.*?)\n```\n)?"
    r"<!-- end -->$",
    re.MULTILINE | re.DOTALL,
)
DIGEST = re.compile(r"\n<!-- recorded from (\w+) -->\n\Z")
NAMED = re.compile(r"[\w./-]+\.(?:toml|py|msh)")
WIDTH = "88"
PROGRESS = re.compile(r"[a-z][\w .]*: +\d+\s?%.*")
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


@dataclass(frozen=True)
class Block:
    """A block of code on a page, with its options and what it printed."""

    options: dict[str, str]
    language: str
    code: str
    output: str


def blocks_of(text: str) -> list[Block]:
    """The recorded blocks of a page, in order."""
    return [_block(match) for match in BLOCK.finditer(text)]


def _block(match: re.Match[str]) -> Block:
    options = {}
    for option in (match["options"] or "").split(";"):
        name, _, value = option.strip().partition(" ")
        if name:
            options[name] = value
    return Block(options, match["language"], match["code"], match["output"] or "")


def digest_of(text: str) -> str:
    """A digest of all blocks of a page, and of the files of the project that they name."""
    hashed = hashlib.sha256()
    for block in blocks_of(text):
        stated = [block.options, block.language, block.code]
        hashed.update(json.dumps(stated, sort_keys=True).encode())
        for name in sorted(set(NAMED.findall(block.code))):
            if (ROOT / name).is_file():
                hashed.update(name.encode() + (ROOT / name).read_bytes())
    return hashed.hexdigest()[:16]


def is_as_recorded(text: str) -> bool:
    """Whether a page's blocks and the files that they name are those of its record."""
    digest = DIGEST.search(text)
    return digest is not None and digest[1] == digest_of(text)


def pages() -> list[Path]:
    """All pages with recorded blocks."""
    return sorted(path for path in DOCS.rglob("*.md") if blocks_of(path.read_text("utf-8")))


def notebooks() -> list[Path]:
    """All notebooks."""
    return sorted((DOCS / "notebooks").glob("*.ipynb"))


def record(page: Path) -> None:
    """Run the blocks of a page and write what they print into it."""
    text = page.read_text(encoding="utf-8")
    outputs = iter(run_blocks(page, STORE))

    def with_output(match: re.Match[str]) -> str:
        output = next(outputs)
        code = f"```{match['language']}\n{match['code']}```\n"
        shown = f"\n```text\n{output}\n```\n" if output else ""
        options = f": {match['options']}" if match["options"] else ""
        return f"<!-- recorded{options} -->\n{code}{shown}<!-- end -->"

    text = DIGEST.sub("", BLOCK.sub(with_output, text)).rstrip("\n")
    page.write_text(f"{text}\n\n<!-- recorded from {digest_of(text)} -->\n", encoding="utf-8")


def run_blocks(page: Path, store: Path) -> list[str]:
    """The output of every block of a page; pictures that it keeps go to `store`."""
    outputs = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("data", "examples"):
            shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("*.h5"))
        (folder / "training").mkdir()
        environment = _environment(folder)
        for block in blocks_of(page.read_text(encoding="utf-8")):
            if "file" in block.options:
                (folder / block.options["file"]).write_text(block.code, encoding="utf-8")
                outputs.append("")
                continue
            call = [sys.executable, "-c"] if block.language == "python" else ["bash", "-ec"]
            done = subprocess.run(
                [*call, block.code],
                cwd=folder,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                encoding="utf-8",
                check=False,
            )
            if done.returncode and "fails" not in block.options:
                sys.exit(f"{page.name}: {block.code}\n{done.stdout}")
            printed = CONTROL.sub("", done.stdout).replace(str(folder), "")
            lines = [line.rstrip() for line in printed.splitlines() if not PROGRESS.fullmatch(line)]
            outputs.append("\n".join(lines).strip())
            for picture in block.options.get("keep", "").split():
                shutil.copyfile(folder / picture, store / f"{page.stem}-{Path(picture).name}")
    return outputs


def _environment(folder: Path) -> dict[str, str]:
    tools = folder / ".bin"
    tools.mkdir()
    command = tools / "surrofe2"
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m surrofe2 "$@"\n', encoding="utf-8")
    command.chmod(0o755)
    return {
        **os.environ,
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "COLUMNS": WIDTH,
        "TERM": "dumb",
        "NO_COLOR": "1",
        "PYTHONWARNINGS": "ignore",
    }


def digest_of_notebook(cells: list[dict]) -> str:
    """Of the code of a notebook."""
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    return hashlib.sha256(json.dumps(code).encode()).hexdigest()


def run_notebook(path: Path) -> None:
    """Runs a notebook in place and keeps the digest of its code with it."""
    import nbformat
    from nbclient import NotebookClient

    book = nbformat.read(path, as_version=4)
    os.environ["PYTHONPATH"] = str(ROOT)
    NotebookClient(book, timeout=1200, resources={"metadata": {"path": str(path.parent)}}).execute()
    for cell in book.cells:
        cell.metadata.pop("execution", None)
    book.metadata["digest"] = digest_of_notebook(book.cells)
    nbformat.write(book, path)


def main(names: list[str]) -> None:
    """Records the pages and notebooks named, or all."""
    for path in [*pages(), *notebooks()]:
        if names and path.name not in names and path.stem not in names:
            continue
        print(path.relative_to(ROOT), flush=True)  # noqa: T201 (a script)
        run_notebook(path) if path.suffix == ".ipynb" else record(path)


if __name__ == "__main__":
    main(sys.argv[1:])
