"""Runs what pages and notebooks show and keeps what it printed: `python docs/record.py [PAGE …]`.

A page's blocks run in order in one folder with copies of data/ and examples/. Notebooks run in
place. docs/extensions/recorded.py shows the records, docs/conf.py has the notebooks' settings.
"""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.insert(0, str(DOCS / "extensions"))

from recorded import STORE, blocks_of, digest_of, store_of  # noqa: E402 (beside this file)

WIDTH = "88"
PROGRESS = re.compile(r"[a-z][\w .]*: +\d+\s?%.*")
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def pages() -> list[Path]:
    """All pages with recorded blocks."""
    return sorted(path for path in DOCS.rglob("*.md") if blocks_of(path))


def notebooks() -> list[Path]:
    """All notebooks."""
    return sorted((DOCS / "notebooks").glob("*.ipynb"))


def record(page: Path, store: Path = STORE) -> dict[str, str]:
    """Output of every block of a page by its text, written to its record."""
    said = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in ("data", "examples"):
            shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("*.h5"))
        (folder / "training").mkdir()
        environment = _environment(folder)
        for block in blocks_of(page):
            if "file" in block.options:
                (folder / block.options["file"]).write_text(block.text, encoding="utf-8")
                continue
            python = block.options.get("language") == "python"
            call = [sys.executable, "-c"] if python else ["bash", "-ec"]
            done = subprocess.run(
                [*call, block.text],
                cwd=folder,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                encoding="utf-8",
                check=False,
            )
            if done.returncode and "fails" not in block.options:
                sys.exit(f"{page.name}: {block.text}\n{done.stdout}")
            text = CONTROL.sub("", done.stdout).replace(str(folder), "")
            lines = [line.rstrip() for line in text.splitlines() if not PROGRESS.fullmatch(line)]
            said[block.text.strip()] = "\n".join(lines).strip()
            for picture in block.options.get("keep", "").split():
                target = store / f"{page.stem}-{Path(picture).name}"
                target.parent.mkdir(exist_ok=True)
                shutil.copyfile(folder / picture, target)
    store.mkdir(exist_ok=True)
    kept = {"digest": digest_of(page), "said": said}
    text = json.dumps(kept, indent=1, ensure_ascii=False) + "\n"
    (store / store_of(page).name).write_text(text, encoding="utf-8")
    return said


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
