"""What work costs adds up over calls and processes, and says from when a cache pays."""

from __future__ import annotations

import json
import math
import os
import re
import time
from dataclasses import replace

import numba
import numpy as np
import pytest

from surrofe2.compilation import compiled
from surrofe2.costs import Balance, Cost, Meter, machine
from surrofe2.errors import InputError
from surrofe2.io.provenance import read_cost
from surrofe2.io.run_folder import read_run
from surrofe2.io.surrogates import content_fingerprint, read_surrogate, write_surrogate
from surrofe2.workflow import workers
from surrofe2.workflow.comparison import compare_runs
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.run import run_study
from surrofe2.workflow.workers import executor_of, in_pieces
from tests.laws import SoftLaw, StoppingLaw
from tests.some_work import squares


def test_costs_add_up():
    here = Cost(wall=1.0, cpu=2.0, threads=2, machine="a")
    there = Cost(wall=0.5, cpu=0.5, threads=1, machine="b")
    assert here + there == Cost(wall=1.5, cpu=2.5, threads=2, machine="a + b")
    assert (here + here).machine == "a"
    assert Cost.of(json.loads(here.to_json())) == here
    with pytest.raises(InputError, match=r"cost\.wall: 'x'; it must be a number"):
        Cost.of({**here.to_dict(), "wall": "x"})


@pytest.mark.parametrize(
    ("costs", "gain", "pays_from", "sentence"),
    [
        ((7.6, 0.2, 0.4), 0.4 / 7.8, 38, "it pays from 38 such runs, or from 38 times the elem"),
        ((1.0, 1.0, 20.0), 10.0, 1, "10 times as fast with everything counted; it pays from the"),
        ((1.0, 0.5, 0.4), 0.4 / 1.5, None, "it never pays, since the true run is faster"),
        ((None, 0.2, 0.4), None, None, "is not known"),
    ],
)
def test_when_a_cache_pays(costs, gain, pays_from, sentence):
    balance = Balance(**dict(zip(("made", "run", "true"), costs, strict=True)))
    assert balance.gain == pytest.approx(gain)
    assert balance.pays_from == pays_from
    assert sentence in balance.sentence
    if pays_from:  # so many runs cost no more, one less costs more
        made, run, true = costs
        assert made + pays_from * run <= pays_from * true * (1.0 + 1e-12)
        assert made + (pays_from - 1) * run > (pays_from - 1) * true


def test_a_data_set_counts_all_calls_that_made_it(recipe, monkeypatch):
    recipe = replace(recipe, samples=replace(recipe.samples, count=40))
    law = StoppingLaw(2).of(recipe.cell, recipe.rve)
    with pytest.raises(KeyboardInterrupt):
        generate_data_set(recipe, law, chunk=8)
    before = read_cost(recipe.data_path())
    assert 0.0 < before.wall < 60.0
    monkeypatch.setattr("surrofe2.costs.clock", lambda: next(moments))
    moments = iter(range(1000, 100_000, 7))
    generate_data_set(recipe, SoftLaw().of(recipe.cell, recipe.rve), chunk=8)
    cost = read_cost(recipe.data_path())
    assert cost.wall == pytest.approx(before.wall + 7.0 * round((cost.wall - before.wall) / 7.0))
    assert cost.wall > before.wall
    assert cost.cpu >= before.cpu
    assert cost.threads == numba.get_num_threads()
    assert cost.machine == machine()


def test_compilation_costs_nothing():
    @compiled(cache=False)
    def made(x):
        return np.sqrt(x) + np.sin(x)

    meter, begin = Meter(), time.perf_counter()
    assert made(0.25) == pytest.approx(0.5 + math.sin(0.25))
    taken, cost = time.perf_counter() - begin, meter.cost
    assert 0.0 <= cost.wall < 0.5 * taken
    assert cost.cpu < 0.5 * taken


def test_cpu_seconds_of_other_processes_count(monkeypatch):
    monkeypatch.setattr(workers, "PIECE", 1e-9)
    monkeypatch.setattr(workers, "_measured", _dear)
    meter = Meter()
    with executor_of(1) as executor:
        assert len([*in_pieces(squares, range(12), 2, executor, meter)]) == 6
    assert 40.0 <= meter.cost.cpu < 60.0


def _dear(work, first, count):
    return ("elsewhere", os.getpid()), 10.0, work(first, count)


@pytest.fixture
def learnt(recipe, monkeypatch):
    """The recipe, with data set and surrogate over a law without cells."""
    from surrofe2.workflow import laws
    from surrofe2.workflow.train import train_surrogate

    monkeypatch.setattr(laws, "true_law", lambda part, *_: SoftLaw().of(part.cell, part.rve))
    generate_data_set(recipe)
    train_surrogate(recipe)
    return recipe


def test_a_surrogate_knows_what_it_cost_and_a_comparison_counts_it(learnt, tmp_path):
    path = learnt.training_path()
    cost = read_surrogate(path).cost
    assert set(cost) == {"data", "training", "calibration"}
    assert cost["data"] == read_cost(learnt.data_path())
    assert min(each.wall for each in cost.values()) > 0.0
    for law in ("rve", "cached"):
        run_study(learnt, law, tmp_path / law)
    record = read_run(tmp_path / "cached").record
    assert record.wall_time["cpu"] > 0.0
    assert read_cost(tmp_path / "cached" / "harvest.h5") == Cost(
        wall=record.wall_time["total"],
        cpu=record.wall_time["cpu"],
        threads=record.threads,
        machine=machine(),
    )
    (cached,) = compare_runs([tmp_path / "rve", tmp_path / "cached"], tmp_path / "compared").runs
    made = sum(each.wall for each in cost.values())
    true = read_run(tmp_path / "rve").record.wall_time["total"]
    assert cached.balance == Balance(made=made, run=record.wall_time["total"], true=true)
    assert cached.balance.gain == pytest.approx(true / (made + cached.wall_time))


def test_the_fingerprint_of_a_surrogate_is_not_of_its_cost(learnt, tmp_path):
    surrogate = read_surrogate(learnt.training_path())
    wanted = content_fingerprint(learnt.training_path())
    other = tmp_path / "other.safetensors"
    write_surrogate(replace(surrogate, cost={"training": Cost(wall=9.0)}), other)
    assert content_fingerprint(other) == wanted
    assert re.fullmatch("[0-9a-f]{16}", wanted)
    write_surrogate(replace(surrogate, initialisation="elastic"), other)
    assert content_fingerprint(other) != wanted
    write_surrogate(replace(surrogate, cost={}), other)
    run_study(learnt, "cached", tmp_path / "unknown", surrogates={"": other})
    run_study(learnt, "rve", tmp_path / "rve")
    compared = compare_runs([tmp_path / "rve", tmp_path / "unknown"], tmp_path / "compared")
    assert compared.runs[0].balance.gain is None
