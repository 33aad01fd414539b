import h5py
import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.recipe.recipe import load_recipe
from surrofe2.rve import RveLaw
from surrofe2.store.samples import read_data_set
from surrofe2.workflow.generate import generate_data_set
from tests.laws import SoftLaw, StoppingLaw


@pytest.fixture(autouse=True)
def _small_chunks(monkeypatch):
    monkeypatch.setitem(generate_data_set.__kwdefaults__, "chunk", 16)


def test_failed_samples_are_kept_and_counted(invoke, recipe_path):
    done = invoke("generate", recipe_path, law=SoftLaw(fails_above=1.03))
    samples = read_data_set(recipe_path.parent / "cells.h5")
    failed = int((samples.F[:, 0, 0] > 1.03).sum())
    assert 0 < failed < 40
    assert (samples.status != 0).sum() == failed
    assert (
        f"40 samples, {40 - failed} usable, {failed} failed ({failed}: the RVE solve did not "
        "converge; load in smaller "
        "steps or raise the iteration limit)"
    ) in done.stdout


def test_interrupted_and_continued_equals_uninterrupted(invoke, recipe_path, tmp_path):
    stopped = invoke("generate", recipe_path, law=StoppingLaw(calls=1), code=130)
    assert stopped.stderr.splitlines()[-1] == (
        f"interrupted: the samples so far are kept; resume with: surrofe2 generate {recipe_path}"
    )
    path = recipe_path.parent / "cells.h5"
    with h5py.File(path) as file:
        assert (file.attrs["completed"], file.attrs["status"]) == (16, "writing")
    law = SoftLaw()
    invoke("generate", recipe_path, law=law)
    assert law.calls == 2
    kept = tmp_path / "kept.h5"
    path.rename(kept)
    invoke("generate", recipe_path)
    assert read_data_set(path).fingerprint == read_data_set(kept).fingerprint


def test_a_finished_one_is_kept(invoke, recipe_path):
    invoke("generate", recipe_path)
    before = (recipe_path.parent / "cells.h5").read_bytes()
    law = SoftLaw()
    done = invoke("generate", recipe_path, law=law)
    assert "40 samples (already finished), all usable" in done.stdout
    assert law.calls == 0
    assert (recipe_path.parent / "cells.h5").read_bytes() == before


def test_a_data_set_of_another_recipe_is_refused_unless_fresh(invoke, recipe_path, changed_recipe):
    invoke("generate", recipe_path, law=StoppingLaw(calls=1), code=130)
    other = changed_recipe("seed = 3", "seed = 4")
    refused = invoke("generate", other, code=1)
    assert refused.stderr == (
        f"error: {recipe_path.parent / 'cells.h5'}: samples.seed: this call has 4, what is there "
        "3; change it back, write elsewhere or start over with --fresh\n"
    )
    invoke("generate", other, "--fresh")
    assert read_data_set(recipe_path.parent / "cells.h5").seed == 4


def test_error_is_one_line_and_traceback_on_request(invoke, changed_recipe):
    path = changed_recipe("[cell]", "[sell]")
    refused = invoke("generate", path, env={"COLUMNS": "30"}, code=1)
    assert refused.stdout == ""
    (line,) = refused.stderr.splitlines()
    assert line.startswith("error: recipe.toml: sell: unknown section; did you mean cell? known ")
    for wanted in (
        invoke("--traceback", "generate", path, code=1),
        invoke("generate", path, "--traceback", code=1),
        invoke("generate", path, env={"SURROFE2_TRACEBACK": "1"}, code=1),
    ):
        assert isinstance(wanted.exception, InputError)


def test_tangents_are_those_of_the_rve(changed_recipe):
    path = changed_recipe("count = 40", "count = 20\ntangents = true")
    study = load_recipe(path).study()
    generate_data_set(study)
    samples = read_data_set(study.data_path())
    law = RveLaw(study.cell.parameters, study.recipe.rve)
    asked = law.respond(samples.F, samples.F_dot, tangents=True).tangents
    # the two were computed in tiles of other neighbours
    np.testing.assert_allclose(samples.P_by_F, asked.P_by_F, rtol=0, atol=1e-9)
    np.testing.assert_allclose(samples.P_by_F_dot, asked.P_by_F_dot, rtol=0, atol=1e-7)
    assert np.abs(samples.P_by_F_dot).max() > 1.0
