"""The scripts for SLURM, by stand-ins for its commands on the PATH."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from surrofe2.store.run_folder import read_record
from tests.conftest import RECIPE

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "examples" / "slurm"
SCRIPTS = sorted(FOLDER.glob("*.sh"))
JOB = "77"

SRUN = f"""#!/bin/bash
cores=$SLURM_CPUS_PER_TASK
while [[ $1 == --* ]]; do # options of srun
    [[ $1 == --cpus-per-task=$cores ]] || exit 98
    shift
done
exec {Path(sys.executable).with_name("mpiexec")} -rmk user -launcher fork -n "$SLURM_NTASKS" "$@"
"""
SCONTROL = '#!/bin/bash\necho "$@" >> scontrol.log\n'


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_is_whole_and_on_the_page(script):
    subprocess.run(["bash", "-n", script], check=True)
    page = (ROOT / "docs" / "scaling.md").read_text(encoding="utf-8")
    assert f"{{literalinclude}} ../examples/slurm/{script.name}\n" in page


@pytest.fixture
def job(tmp_path):
    """job(script, *arguments, ntasks): the script as SLURM starts it, in a folder of its own."""
    pytest.importorskip("mpi4py")
    commands = tmp_path / "commands"
    commands.mkdir()
    for name, text in (("srun", SRUN), ("scontrol", SCONTROL)):
        (commands / name).write_text(text, encoding="utf-8")
        (commands / name).chmod(0o755)
    own = Path(sys.executable).parent
    (tmp_path / "recipe.toml").write_text(RECIPE, encoding="utf-8")

    def start(script, *arguments, ntasks=1, **settings):
        known = {"SLURM_JOB_ID": JOB, "SLURM_NTASKS": str(ntasks), "SLURM_CPUS_PER_TASK": "1"}
        return subprocess.Popen(
            ["bash", FOLDER / f"{script}.sh", "recipe.toml", *arguments],
            cwd=tmp_path,
            env={
                **os.environ,
                "PATH": f"{commands}:{own}:{os.environ['PATH']}",
                "PYTHONPATH": str(ROOT),
                **known,
                **settings,
            },
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    start.folder = tmp_path
    return start


def done(process, code=0):
    said, _ = process.communicate(timeout=300)
    assert process.returncode == code, said
    return said


def interrupt(process, sign):
    """SIGINT to the step, not to the script, soon after a file is there."""
    until = time.monotonic() + 120.0
    while not sign.exists() and time.monotonic() < until:
        assert process.poll() is None, process.communicate()[0]
        time.sleep(0.02)
    own = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    os.kill(int(own.read_text(encoding="utf-8")), 2)  # what the script's srun became


def requeued(folder):
    return (folder / "scontrol.log").read_text(encoding="utf-8").splitlines()


@pytest.mark.slow
def test_a_run_over_ranks_goes_back_into_the_queue_and_goes_on(job):
    text = RECIPE.replace("duration = 4.0", "duration = 800.0")
    (job.folder / "recipe.toml").write_text(text, encoding="utf-8")
    process = job("run", "rve", "out/rve", ntasks=2)
    interrupt(process, job.folder / "out" / "rve" / "run.json")
    assert "interrupted: out/rve keeps the run" in done(process, 130)
    assert requeued(job.folder) == [f"requeue {JOB}"]
    assert read_record(job.folder / "out" / "rve").status == "interrupted"
    (job.folder / "scontrol.log").unlink()
    done(job("run", "rve", "out/rve", ntasks=2))
    assert not (job.folder / "scontrol.log").exists()
    record = read_record(job.folder / "out" / "rve")
    assert record.status == "finished"
    assert record.ranks["ranks"] == 2


@pytest.mark.slow
def test_a_grid_by_an_array_and_its_table(job):
    parts = {"SLURM_ARRAY_JOB_ID": "76"}
    for k in (0, 8):
        done(job("grid", SLURM_ARRAY_TASK_ID=str(k), **parts))
    finished = [*job.folder.glob("out/grid/part-*/*/run.json")]
    before = [path.stat().st_mtime_ns for path in finished]
    assert len(before) == 2
    done(job("grid"))
    rows = json.loads((job.folder / "out/grid/grid.json").read_text(encoding="utf-8"))["rows"]
    assert [row["wall_stiffness"] for row in rows] == [*range(3000, 5001, 250)]
    for path, stamp in zip(finished, before, strict=True):
        assert (job.folder / "out/grid" / path.parent.name / "run.json").samefile(path)
        assert path.stat().st_mtime_ns == stamp  # not done again
