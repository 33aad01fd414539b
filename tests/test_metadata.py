"""What the project says of itself: version, authors, addresses, versions of Python, CI."""

import re
import subprocess
import tomllib

import pytest

from tests.conftest import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
AUTHORS = [author["name"] for author in PROJECT["authors"]]
PLACEHOLDER = re.compile(r"example\.(org|com|net)|zenodo\.(x+|0+)\b|the surrofe2 developers", re.I)
PLACES = {"pyproject.toml", "CITATION.cff", "LICENSE"}
"""Where authors, addresses and DOI stand; the last two repeat the authors of the first."""
INVENTED = {"tests/test_metadata.py", "tests/cli/test_names.py"}
"""Tests that make up an address."""
PYTHONS = ["3.11", "3.12", "3.13", "3.14"]


def text_of(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_version_is_that_of_the_citation_and_of_the_newest_release_in_the_changelog():
    assert (
        re.search(r"^version: (.*)$", text_of("CITATION.cff"), re.MULTILINE)[1]
        == PROJECT["version"]
    )
    releases = re.findall(
        r"^## (\d\S*) \((\d{4}-\d\d-\d\d)\)$", text_of("CHANGELOG.md"), re.MULTILINE
    )
    assert releases[0][0] == PROJECT["version"]
    dates = [date for _, date in releases]
    cited = re.search(r"^date-released: (\S*)$", text_of("CITATION.cff"), re.MULTILINE)
    assert cited[1] == dates[0]
    assert dates == sorted(dates, reverse=True)


def test_every_heading_of_the_changelog_is_a_dated_release_or_unreleased():
    headings = re.findall(r"^## (.*)$", text_of("CHANGELOG.md"), re.MULTILINE)
    assert headings[0] == "Unreleased"
    assert all(re.fullmatch(r"\d+\.\d+\.\d+ \(\d{4}-\d\d-\d\d\)", each) for each in headings[1:])


def test_citation_and_licence_have_the_authors_and_the_address_of_the_package():
    cited = re.findall(r'^  - name: "(.*)"$', text_of("CITATION.cff"), re.MULTILINE)
    assert cited == AUTHORS
    address = re.search(r'^repository-code: "(.*?)"', text_of("CITATION.cff"), re.MULTILINE)
    assert address[1] == PROJECT["urls"]["Source"]
    holder = re.search(r"^Copyright \(c\) \d{4}, (.*)$", text_of("LICENSE"), re.MULTILINE)[1]
    assert holder.lower() == ", ".join(AUTHORS).lower()


def test_authors_addresses_and_doi_stand_in_one_place():
    """A placeholder elsewhere would be forgotten on the day that it is replaced."""
    if not (ROOT / ".git").exists():
        pytest.skip("only a repository says which files are its own")
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.split("\0")  # fmt: skip
    elsewhere = []
    for name in listed:
        path = ROOT / name
        is_text = path.suffix in {".md", ".py", ".toml", ".cff", ".yml", ".yaml", ".sh", ".in", ""}
        if not (name and is_text and path.is_file()) or name in PLACES | INVENTED:
            continue
        if PLACEHOLDER.search(path.read_text(encoding="utf-8")):
            elsewhere.append(name)
    assert not elsewhere


def test_versions_of_python_are_those_that_ci_tests():
    classified = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert classified == PYTHONS
    assert PROJECT["requires-python"] == f">={PYTHONS[0]}"
    stated = re.search(r"python: (\[\S.*\])", text_of(".github/workflows/ci.yml"))[1]
    assert re.findall(r"3\.\d+", stated) == PYTHONS


def test_local_ci_runs_what_the_workflow_runs():
    commands = re.findall(r"^make .*$", text_of(".ci/run"), re.MULTILINE)
    assert commands == ["make lint", "make test"]
    workflow = text_of(".github/workflows/ci.yml")
    for command in (*commands, "make docs", "make test-slow", "make test-nightly"):
        assert f"run: {command}\n" in workflow
