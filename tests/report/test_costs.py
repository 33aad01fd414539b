"""Seconds of work add up over calls, and say from when a cache pays."""

import re
from dataclasses import replace

import pytest

from surrofe2.report.comparison import Balance, compare_runs, made_for
from surrofe2.store.hdf5 import read_seconds
from surrofe2.store.run_folder import read_run
from surrofe2.store.surrogates import content_fingerprint, read_surrogate, write_surrogate
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.run import run_study
from tests.laws import SoftLaw


@pytest.mark.parametrize(
    ("costs", "gain", "pays_from", "sentence"),
    [
        ((7.6, 0.2, 0.4), 0.4 / 7.8, 38, "it pays off after 38 such runs, or on 38 times as many"),
        ((1.0, 1.0, 20.0), 10.0, 1, "10 times faster than full FE²; it pays off in the first"),
        ((1.0, 0.5, 0.4), 0.4 / 1.5, None, "it never pays off, since full FE² is faster"),
        ((None, 0.2, 0.4), None, None, "is not known"),
    ],
)
def test_when_a_cache_pays(costs, gain, pays_from, sentence):
    balance = Balance(**dict(zip(("preparation", "run", "true"), costs, strict=True)))
    assert balance.gain == pytest.approx(gain)
    assert balance.pays_from == pays_from
    assert sentence in balance.sentence
    if pays_from:  # so many runs cost no more, one less costs more
        made, run, true = costs
        assert made + pays_from * run <= pays_from * true * (1.0 + 1e-12)
        assert made + (pays_from - 1) * run > (pays_from - 1) * true


@pytest.fixture
def learnt(recipe, monkeypatch):
    """The recipe, with data set and surrogate over a law without cells."""
    from surrofe2.workflow import laws
    from surrofe2.workflow.train import train_surrogate

    monkeypatch.setattr(
        laws, "true_law", lambda study: SoftLaw().of(study.cell.parameters, study.recipe.rve)
    )
    generate_data_set(recipe.study())
    train_surrogate(recipe.study())
    return recipe


def test_a_surrogate_knows_what_it_took_and_a_comparison_counts_it(learnt, tmp_path):
    path = learnt.study().training_path()
    seconds = read_surrogate(path).seconds
    assert set(seconds) == {"data", "training", "calibration"}
    assert seconds["data"] == read_seconds(learnt.study().data_path())
    assert min(seconds.values()) > 0.0
    for law in ("rve", "cached"):
        run_study(learnt, law, tmp_path / law)
    record = read_run(tmp_path / "cached").record
    assert record.wall_time["cpu"] > 0.0
    assert read_seconds(tmp_path / "cached" / "harvest.h5") == record.wall_time["total"]
    (cached,) = compare_runs([tmp_path / "rve", tmp_path / "cached"], tmp_path / "compared").runs
    made = sum(seconds.values())
    true = read_run(tmp_path / "rve").record.wall_time["total"]
    assert cached.balance == Balance(preparation=made, run=record.wall_time["total"], true=true)
    assert cached.balance.gain == pytest.approx(true / (made + cached.wall_time))
    assert made_for(record) == made
    assert made_for(replace(record, surrogate={**record.surrogate, "seconds": {}})) is None


def test_the_fingerprint_of_a_surrogate_is_not_of_its_seconds(learnt, tmp_path):
    surrogate = read_surrogate(learnt.study().training_path())
    wanted = content_fingerprint(learnt.study().training_path())
    other = tmp_path / "other-surrogate.h5"
    write_surrogate(replace(surrogate, seconds={"training": 9.0}), other)
    assert content_fingerprint(other) == wanted
    assert re.fullmatch("[0-9a-f]{16}", wanted)
    write_surrogate(replace(surrogate, initialisation="elastic"), other)
    assert content_fingerprint(other) != wanted
