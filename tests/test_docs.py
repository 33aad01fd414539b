"""The pages: plain words, links that lead somewhere, and a site that is complete and shows what
commands, notebooks and the README's example print.
"""

import ast
import contextlib
import dataclasses
import importlib
import importlib.util
import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter

import pytest

import surrofe2
from tests.conftest import ROOT
from tests.processes import python

DOCS = ROOT / "docs"
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *(ROOT / name for name in ("data/README.md", "training/README.md")),
    *sorted(DOCS.rglob("*.md")),
    *sorted((ROOT / "examples").glob("*.md")),
]
IN_PLAIN_WORDS = [
    *(page for page in PAGES if page.parent != ROOT or page.stem == "README"),
    *(
        path
        for folder in ("data", "examples", "surrofe2/templates")
        for path in sorted((ROOT / folder).glob("*.toml"))
    ),
    *sorted((ROOT / "surrofe2").rglob("*.py")),
    *(
        path
        for folder in ("benchmarks", "docs", "examples", "validation")
        for path in sorted((ROOT / folder).rglob("*.py"))
    ),
]
"""Pages, recipes and sources whose words are looked at."""
INSTEAD = {
    r"\bin the place of\b": "instead of",
    r"\banew\b": "again",
    r"\bdear(er)?\b": "expensive, more expensive",
    r"\btrue RVEs?\b": "RVE",
    r"\btrue (FE²|runs?|stress(es)?|one)\b": "full FE², full run, RVE stress",
    r"\bgoes on\b": "resumes, continues",
    r"\bmended\b": "fixed",
    r"\bis told\b": "is reported",
    r"\b(with|in|by|gives|ends) (a|one) sentence\b": "an error message",
    r"\b(cells|particles) an RVE\b": "per RVE",
    r"\b(elements|moduli|springs) a side\b": "per side",
    r"\bkept steps?\b": "accepted step",
    r"\bmade samples?\b": "generated sample",
    r"\bshare of (the )?(spread|tolerance|samples|stress|answers|duration)\b": "fraction of",
}
"""Words that pages do without; CONTRIBUTING.md has the list."""


def relative(page):
    return str(page.relative_to(ROOT))


def without_code(page):
    return re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def words_for_people(path):
    """The text of a page without code, the comments of a recipe, all texts of a Python file."""
    if path.suffix == ".toml":
        return " ".join(re.findall(r"#\s*(.*)", path.read_text(encoding="utf-8")))
    if path.suffix == ".py":
        tree = ast.parse(path.read_text(encoding="utf-8"))
        constants = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))
        return " | ".join(value for value in constants if isinstance(value, str))
    return re.sub(r"^#+ .*$", r"\g<0>.", without_code(path), flags=re.MULTILINE)


def unplain(text):
    """Words that have a plainer one, each with some text before it and what to write."""
    text = " ".join(text.split())
    parts = []
    for pattern, better in INSTEAD.items():
        parts += [
            f"{match[0]!r}: write {better!r}"
            for match in re.finditer(f".{{0,30}}{pattern}", text, re.IGNORECASE)
        ]
    return parts


@pytest.mark.parametrize("path", IN_PLAIN_WORDS, ids=relative)
def test_pages_recipes_and_sources_are_in_plain_words(path):
    assert not unplain(words_for_people(path))


def test_unplain_words_are_seen_in_pages_recipes_and_sources(tmp_path):
    texts = {
        "page.md": "Nine cells an RVE.\n\n```\nNine cells an RVE.\n```\n",
        "recipe.toml": 'cells = 9 # true RVEs are\n# expensive\nname = "anew"\n',
        "source.py": 'def f():\n    """A share of the\n    spread."""\n    anew = f"{1} is mended"',
    }
    seen = {}
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        seen[name] = len(unplain(words_for_people(tmp_path / name)))
    assert seen == {"page.md": 1, "recipe.toml": 1, "source.py": 2}


def settings_with_meanings():
    """Every field of a settings dataclass of the package that states its meaning."""
    kinds = set()
    for path in sorted((ROOT / "surrofe2").rglob("*.py")):
        if "= setting(" in path.read_text(encoding="utf-8"):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            module = importlib.import_module(name)
            kinds.update(kind for kind in vars(module).values() if dataclasses.is_dataclass(kind))
    for kind in kinds:
        if isinstance(kind, type):
            for item in dataclasses.fields(kind):
                if item.metadata.get("about"):
                    yield f"{kind.__name__}.{item.name}", item.metadata["about"]


def test_a_meaning_names_the_thing_itself():
    """A meaning is read beside its key in a table: "stiffness of a wall spring", not "of a …"."""
    clipped = [name for name, about in settings_with_meanings() if re.match(r"(of|at) ", about)]
    assert not clipped


@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_the_example_prints_what_the_first_page_says(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.search(r"```python\n(.*?)```\s+```(?:text)?\n(.*?)```", text, re.DOTALL)
    code, output = blocks.groups()
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, page, "exec"), {})
    assert printed.getvalue() == output


def anchor(heading: str) -> str:
    """What GitHub makes of a heading."""
    kept = re.sub(r"[^\w\- ]", "", heading.strip().lower())
    return kept.replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", without_code(page)):
        if target.startswith("http"):
            continue
        name, _, place = target.partition("#")
        there = (page.parent / name) if name else page
        assert there.exists(), f"{page.name}: {target}"
        if place:
            headings = re.findall(r"^#+ (.*)$", there.read_text(encoding="utf-8"), re.MULTILINE)
            assert place in [anchor(heading) for heading in headings], f"{page.name}: {target}"


@pytest.mark.parametrize(
    "script", sorted(ROOT.glob("examples/slurm/*.sh")), ids=lambda path: path.stem
)
def test_a_script_for_slurm_is_whole_and_on_the_page(script):
    subprocess.run(["bash", "-n", script], check=True)
    page = (ROOT / "docs" / "scaling.md").read_text(encoding="utf-8")
    assert f"{{literalinclude}} ../examples/slurm/{script.name}\n" in page


def module_of(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # its dataclasses look there
    spec.loader.exec_module(module)
    return module


record = module_of(DOCS / "record.py")


@pytest.mark.slow
def test_it_builds_without_a_warning(tmp_path):
    build = ("-m", "sphinx", "-q", "-W", "--keep-going", "-c", "docs", "-d", tmp_path / "trees")
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    python(*build, ".", tmp_path / "site", cwd=ROOT, env=env, timeout=600)
    theory = (tmp_path / "site/docs/theory.html").read_text(encoding="utf-8")
    text = (DOCS / "theory.md").read_text(encoding="utf-8")
    for number in {"1", "57b", "66", *re.findall(r"\((A\d+)\)", text)}:  # as the paper has them
        assert f'id="equation-{number.lower()}"' in theory
    assert 'href="#equation-a7"' in theory
    assert (tmp_path / "site/_static/mathjax/tex-chtml.js").stat().st_size > 1e6
    for page in (tmp_path / "site/docs").rglob("*.html"):
        loaded = re.findall(r'(?:src|href)="(https?://[^"]+\.(?:js|css))"', page.read_text("utf-8"))
        assert not loaded, page  # it works offline
    for page in (tmp_path / "site/docs/reference/api").glob("*.html"):
        text = re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8"))
        assert not re.findall(r"ndarray\[|ForwardRef|factory|\*args, \*\*kwargs", text), page
        assert page.stem == "index" or "[source]" in text, page
    assert not wider_than_a_phone(tmp_path / "site")


WIDTHS = """<!doctype html><meta charset="utf-8"><body><iframe id="frame" width="390" height="844">
</iframe><script>
const pages = PAGES, wide = [], frame = document.getElementById("frame");
function look(k) {
  if (k === pages.length) { document.title = "all " + JSON.stringify(wide); return; }
  frame.onload = () => {
    const page = frame.contentDocument;
    const boxes = [page.documentElement, ...page.querySelectorAll(".bd-article-container")];
    if (boxes.some(box => box.scrollWidth > box.clientWidth)) wide.push(pages[k]);
    look(k + 1);
  };
  frame.src = pages[k];
}
look(0);
</script>"""


def wider_than_a_phone(site):
    """Pages that scroll sideways as a whole in a window of 390 pixels, by Chromium where it is."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        return []
    pages = [str(page.relative_to(site)) for page in sorted((site / "docs").rglob("*.html"))]
    harness = site / "widths.html"
    harness.write_text(WIDTHS.replace("PAGES", json.dumps(pages)), encoding="utf-8")
    call = [program, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
    call += ["--allow-file-access-from-files", f"--user-data-dir={site.parent / 'profile'}"]
    call += ["--virtual-time-budget=600000", "--dump-dom", harness.as_uri()]
    done = subprocess.run(call, capture_output=True, text=True, check=True, timeout=300)
    return json.loads(re.search(r"<title>all (.*?)</title>", done.stdout)[1])


def test_every_public_name_is_on_one_page_of_the_reference():
    pages = [page.read_text(encoding="utf-8") for page in (DOCS / "reference/api").glob("*.md")]
    told = re.findall(r"^\.\. auto(?:class|function):: (\w+)", "\n".join(pages), re.MULTILINE)
    assert sorted(told) == sorted(surrofe2.__all__)


def test_every_example_is_in_the_gallery():
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    linked = set(re.findall(r":link: \.\./examples/(\S+)", text))
    assert linked == {page.stem for page in (ROOT / "examples").glob("*.md")} - {"README"}


def test_each_recipe_and_script_of_an_example_is_shown_on_one_page():
    shown = Counter()
    for page in PAGES:
        names = set(re.findall(r"\{literalinclude\} (\S+)", page.read_text(encoding="utf-8")))
        shown.update((page.parent / name).resolve() for name in names)
    examples = ROOT / "examples"
    files = {*examples.glob("*.toml"), *examples.glob("*.py")} - {examples / "picture.py"}
    assert {path for path in files if shown[path] != 1} == set()
    assert max(shown.values()) == 1


IMPORT = re.compile(r"from (surrofe2[.\w]+) import (\([^)]*\)|[^\n]*)")


@pytest.mark.parametrize(
    "path",
    [
        *PAGES,
        *sorted((ROOT / "examples").glob("*.py")),
        *sorted((DOCS / "gallery").glob("*.py")),
        *record.notebooks(),
    ],
    ids=relative,
)
def test_names_of_the_reference_are_imported_from_the_package_itself(path):
    """Not from the module that has them, which may change."""
    text = path.read_text(encoding="utf-8").replace("\\n", "\n")  # of notebooks
    deep = [name for _, names in IMPORT.findall(text) for name in re.findall(r"\w+", names)]
    deep += re.findall(r"\bsurrofe2\.[.\w]*\.(\w+)", without_imports(text))
    assert not set(deep) & set(surrofe2.__all__)


def without_imports(text):
    return IMPORT.sub("", text)


@pytest.mark.parametrize("book", record.notebooks(), ids=lambda path: path.stem)
def test_notebooks_show_what_their_code_printed(book):
    read = json.loads(book.read_text(encoding="utf-8"))
    assert read["metadata"]["digest"] == record.digest_of_notebook(read["cells"]), (
        f"python docs/record.py {book.name}"
    )
    assert any(cell.get("outputs") for cell in read["cells"])


@pytest.mark.slow
@pytest.mark.parametrize("book", record.notebooks(), ids=lambda path: path.stem)
def test_notebooks_run(book, tmp_path, monkeypatch):
    """Each in a kernel of its own; a cell that raises would raise here, too."""
    pytest.importorskip("nbclient")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    copy = tmp_path / book.name
    shutil.copyfile(book, copy)
    record.run_notebook(copy)
    cells = [cell for cell in json.loads(copy.read_text("utf-8"))["cells"] if "outputs" in cell]
    stored = [cell for cell in json.loads(book.read_text("utf-8"))["cells"] if "outputs" in cell]
    assert [bool(cell["outputs"]) for cell in cells] == [bool(cell["outputs"]) for cell in stored]


def test_binder_installs_the_package_with_the_pinned_versions():
    lines = (ROOT / ".binder/requirements.txt").read_text(encoding="utf-8").splitlines()
    assert lines == ["-c ../constraints.txt", "."]
    assert os.access(ROOT / ".binder/postBuild", os.X_OK)
    python_of_binder = (ROOT / ".binder/runtime.txt").read_text(encoding="utf-8").strip()
    assert python_of_binder == "python-3.11"  # that of constraints.txt


def words(text: str) -> list[str]:
    """First words of lines that begin at the margin, without the figures: those are the machine's,
    and so are widths of tables and sentences on what pays.
    """
    lines = [line for line in text.splitlines() if line[:1].strip()]
    return [re.sub(r"[\d.,e+−-]+", "#", line.split()[0]) for line in lines]


@pytest.mark.parametrize("page", record.pages(), ids=relative)
def test_pages_are_recorded_from_the_commands_and_recipes_of_today(page):
    assert record.is_as_recorded(page.read_text(encoding="utf-8")), (
        f"python docs/record.py {page.name}"
    )


def test_a_changed_command_or_output_is_written_into_the_page(tmp_path):
    page = tmp_path / "page.md"
    block = "<!-- recorded -->\n```python\nprint({})\n```\n{}<!-- end -->\n"
    page.write_text(block.format(5, "\n```text\n4\n```\n") + "\nWords.\n", encoding="utf-8")
    assert not record.is_as_recorded(page.read_text(encoding="utf-8"))
    record.record(page)
    text = page.read_text(encoding="utf-8")
    assert text.startswith(block.format(5, "\n```text\n5\n```\n") + "\nWords.\n")
    assert record.is_as_recorded(text)
    assert not record.is_as_recorded(text.replace("print(5)", "print(6)"))


@pytest.mark.slow
@pytest.mark.parametrize("page", record.pages(), ids=relative)
def test_commands_print_what_pages_say(page, tmp_path):
    shown = [block.output for block in record.blocks_of(page.read_text(encoding="utf-8"))]
    now = record.run_blocks(page, tmp_path)
    assert [*map(words, now)] == [*map(words, shown)]
