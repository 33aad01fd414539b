"""The wheel and the sdist, installed without the repository, do a whole study."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from email import message_from_bytes
from pathlib import Path

import pytest

from tests.conftest import RECIPE, ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
NAME = f"surrofe2-{PROJECT['version']}"


def call(*words, cwd):
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    words = [str(each) for each in words]
    done = subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with the sdist of the files that are in the repository, and the sdist's wheel."""
    if not (ROOT / ".git").exists():
        pytest.skip("an sdist of an sdist says nothing")
    folder = tmp_path_factory.mktemp("built")
    listed = call("git", "ls-files", "-z", "--cached", cwd=ROOT).split("\0")
    for name in filter(lambda name: name and (ROOT / name).is_file(), listed):
        copy = folder / "source" / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, copy)
    build = "import sys; from setuptools import build_meta as b; b.build_{}(sys.argv[1])"
    call(sys.executable, "-c", build.format("sdist"), folder, cwd=folder / "source")
    call("tar", "xzf", f"{NAME}.tar.gz", cwd=folder)
    call(sys.executable, "-c", build.format("wheel"), folder, cwd=folder / NAME)
    return folder


@pytest.mark.slow
def test_the_sdist_has_every_file_of_the_repository(built):
    def files(folder):
        return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}

    missing = files(built / "source") - files(built / NAME)
    assert {name for name in missing if not name.startswith((".", "build/"))} == set()


@pytest.mark.slow
def test_the_wheel_states_what_an_index_shows(built):
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        (name,) = (each for each in wheel.namelist() if each.endswith(".dist-info/METADATA"))
        stated = message_from_bytes(wheel.read(name))
    assert stated["Version"] == PROJECT["version"]
    assert stated["Author"] == PROJECT["authors"][0]["name"]
    assert stated["Keywords"]
    assert set(stated.get_all("Provides-Extra")) == set(PROJECT["optional-dependencies"])
    readme = stated.get_payload(decode=True).decode()
    links = re.findall(r"\]\((\S+?)\)", readme)
    assert links
    assert all(link.startswith("https://") for link in links)


@pytest.mark.slow
def test_an_installed_wheel_does_a_study(built, tmp_path):
    """Into a new environment; dependencies are those of the environment that runs the tests."""
    home = tmp_path / "environment"
    venv.create(home, with_pip=False)
    python = home / "bin" / "python"
    (folder,) = home.glob("lib/python*/site-packages")
    (wheel,) = built.glob("*.whl")
    options = ("--no-deps", "--no-index", "--quiet", "--disable-pip-version-check")
    call(sys.executable, "-m", "pip", "--python", python, "install", *options, wheel, cwd=tmp_path)
    dependencies = sysconfig.get_path("purelib")
    (folder / "dependencies.pth").write_text(f"{dependencies}\n", encoding="utf-8")
    do_a_study(home, tmp_path / "work")


@pytest.mark.nightly
@pytest.mark.parametrize("version", ["3.12", "3.13", "3.14"])
def test_a_study_by_another_python(built, tmp_path, version):
    of_pyenv = Path.home().glob(f".pyenv/versions/{version}.*/bin/python")
    python = next(of_pyenv, None) or shutil.which(f"python{version}")
    home = tmp_path / "environment"
    if python is None or version in sys.version:
        pytest.skip(f"there is no Python {version}, or it runs all tests")
    call(python, "-m", "venv", home, cwd=tmp_path)
    pinned = ("install", "--quiet", "-c", ROOT / "constraints.txt")
    call(home / "bin" / "python", "-m", "pip", *pinned, next(built.glob("*.whl")), cwd=tmp_path)
    do_a_study(home, tmp_path / "work")


def do_a_study(home, work):
    """By the installation in an environment, which is used and not the repository."""
    work.mkdir()
    python = home / "bin" / "python"
    where = call(python, "-c", "import surrofe2; print(surrofe2.__file__)", cwd=work).strip()
    assert Path(where).is_relative_to(home)
    (work / "small.toml").write_text(RECIPE, encoding="utf-8")
    command = home / "bin" / "surrofe2"
    for line in (
        "new bar.toml --example bar",
        "check small.toml",
        "run small.toml --law rve --out out/rve",
        "generate small.toml",
        "train small.toml",
        "study small.toml --out out/study",
    ):
        call(command, *line.split(), cwd=work)
    assert list((work / "out").rglob("run.json"))
    assert list((work / "out").rglob("*.html"))
