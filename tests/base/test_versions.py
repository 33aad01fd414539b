"""A report of versions: complete, short, and silent about who asks."""

import getpass
import os
import platform
import tomllib

import numba
import pytest

from surrofe2 import report_versions
from surrofe2.base import versions
from tests.conftest import ROOT
from tests.processes import python

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def rows(text):
    return dict(line.split(maxsplit=1) for line in text.splitlines())


def test_a_report_has_every_dependency_the_machine_and_threads():
    stated = rows(report_versions())
    names = {each.split(">")[0].split("=")[0] for each in PROJECT["dependencies"]}
    assert names <= set(stated)
    assert stated["surrofe2"] == PROJECT["version"]
    assert platform.python_version() in stated["python"]
    assert f"{os.cpu_count()} cores" in stated["processor"]
    assert stated["threads"].startswith(f"{numba.get_num_threads()} of ")


def test_a_missing_dependency_is_named_and_a_missing_extra_is_not(monkeypatch):
    def stated_version(name):
        if name in ("torch", "mpi4py"):
            raise versions.PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr(versions, "version", stated_version)
    stated = rows(report_versions())
    assert stated["torch"] == "not installed"
    assert "mpi4py" not in stated


def test_a_report_does_not_say_whose_it_is():
    text = report_versions()
    assert platform.node() not in text
    assert os.path.expanduser("~") not in text
    if len(getpass.getuser()) > 4:  # "root" is also part of other words
        assert getpass.getuser() not in text


@pytest.mark.parametrize("name", ["NUMBA_NUM_THREADS", "OMP_NUM_THREADS"])
def test_a_report_has_what_the_environment_says_of_threads(monkeypatch, name):
    monkeypatch.setenv(name, "1")
    assert rows(report_versions())[name] == "1"


def test_the_command_prints_the_report():
    done = python("-m", "surrofe2", "--versions")
    assert rows(done.stdout)["surrofe2"] == PROJECT["version"]
