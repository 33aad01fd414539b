"""One small file of each kind, and how it is read."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.recipe.problem_sections import load_mesh
from surrofe2.recipe.recipe import load_recipe
from surrofe2.report.comparison import compare
from surrofe2.store.fields import write_fields
from surrofe2.store.hdf5 import read_checkpoint, write_checkpoint
from surrofe2.store.run_folder import (
    read_run,
    write_curves,
    write_record,
)
from surrofe2.store.samples import (
    HarvestWriter,
    read_data_set,
    read_harvest,
    read_reference,
    write_reference,
    writing_data_set,
)
from surrofe2.store.store import read_json, write_json
from surrofe2.store.surrogates import (
    read_surrogate,
    read_training,
    write_surrogate,
    write_training,
)
from surrofe2.store.tables import read_table, write_table
from surrofe2.surrogate import TrainingSettings, train
from surrofe2.surrogate.domain import Calibration, fit_domain, scale_products
from surrofe2.workflow.zoom import read_motion
from tests.cache.tables import make, states, taught
from tests.fuzz.test_recipes import ROOT
from tests.laws import CELL, SoftLaw, lattice_samples
from tests.run_records import finished_record
from tests.store.gmsh_files import QUADS
from tests.store.small_data_set import HEADER, append_chunk, write_all

POINTS = np.eye(2) + 0.01 * np.arange(8.0).reshape(2, 2, 2), 0.001 * np.ones((2, 2, 2))
T = np.arange(5.0)
KEPT = {"law": "rve"}


def data_set(folder):
    write_all(folder / "set.h5")


def unfinished(folder):
    with writing_data_set(folder / "begun.h5", HEADER) as data:
        append_chunk(data, SoftLaw())


def continued(path):
    with writing_data_set(path, HEADER) as data:
        return data.completed, data.status_counts()


def harvest(folder):
    writer = HarvestWriter(folder / "harvest.h5", HEADER)
    writer(*POINTS, POINTS[0], np.zeros(2, np.int8), np.ones(2, np.int8))
    writer.flush()


def table(folder):
    write_table(folder / "table.h5", taught(*states(5)), {"recipe": "recipe.toml"})


def asked_table(path):
    found, table = read_table(path), make()
    table.restore(found.records)
    return found, table.lookup(*POINTS)


def surrogate(folder):
    settings = TrainingSettings(hidden=(4,), baseline_degree=2, iterations=2)
    samples = lattice_samples(200)
    law = train(samples, settings)
    bound = Calibration(
        scale=np.ones(len(scale_products())), quantile=0.7, alpha=0.01, confidence=0.95,
        stress_spread=10.0, kinds={"walks": {"paths": 9, "quantile": 1.0}}, settings={"walks": 9},
        data_fingerprint=law.data_fingerprint, subject=law.network.fingerprint(law.range),
    )  # fmt: skip
    rest = ReferenceState(law.cell.fingerprint, np.eye(2), np.eye(2), 1.5)
    law = replace(law, domain=fit_domain(samples), calibration=bound, reference=rest)
    write_surrogate(law, folder / "law-surrogate.h5")


def asked_surrogate(path):
    law = read_surrogate(path)
    made = law.version, law.rest_length, law.stress_spread, law.data_fingerprint
    return law.lookup(*POINTS), law.tangents(*POINTS), made


def training(folder):
    identity, arrays = {"data": "0123"}, {"network.a": np.ones(3)}
    write_training(folder / "training.h5", identity, 7, arrays)


def checkpoint(folder):
    arrays = {"macro/t": np.ones(3), "law/status": np.ones(2, np.int8)}
    write_checkpoint(folder / "checkpoint.h5", arrays, "a rve run")


def fields(folder):
    numbers = np.random.default_rng(0)
    shapes = dict.fromkeys(("stress", "F", "F_dot"), (2, 1, 2, 2))
    shapes |= dict.fromkeys(("displacement", "velocity"), (2, 4, 2))
    shapes |= dict.fromkeys(("source", "risk", "dissipated"), (2, 1))
    frames = {name: numbers.normal(size=shape) for name, shape in shapes.items()}
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    of_time = SimpleNamespace(t=np.arange(2.0), **frames)
    write_fields(folder, square, np.array([[0, 1, 2, 3]]), of_time, np.zeros(1))


def run(folder):
    recipe = load_recipe(ROOT / "data" / "bending-bar.toml")
    write_curves(
        folder, T, {"tip": np.stack([T, -T], axis=1)}, {"force hold x": T, "force hold y": -T}, {}
    )
    record = finished_record(recipe, "rve", {"total": 3.0, "law": 2.0}, {"steps": 80})
    write_record(folder, record)


def compared_run(path):
    found = read_run(path.parent)
    result = compare([found, found]).to_dict()
    json.dumps(result)
    return found.record, found.curve.displacement, found.history, found.record.compared()


def reference(folder):
    write_reference(folder / "reference.h5", ReferenceState(CELL.fingerprint, *[np.eye(2)] * 2, 1))


def mesh(folder):
    (folder / "mesh.msh").write_text(QUADS, encoding="utf-8")


KINDS = {
    "set.h5": (data_set, read_data_set),
    "begun.h5": (unfinished, continued),
    "harvest.h5": (harvest, read_harvest),
    "table.h5": (table, asked_table),
    "law-surrogate.h5": (surrogate, asked_surrogate),
    "training.h5": (training, read_training),
    "checkpoint.h5": (checkpoint, lambda path: read_checkpoint(path, "a rve run")),
    "fields.h5": (fields, lambda path: read_motion(path.parent)),
    "run.json": (run, compared_run),
    "some.json": (
        lambda folder: write_json(folder / "some.json", {"a": [1.0, {"b": None}]}),
        read_json,
    ),
    "reference.h5": (reference, lambda path: read_reference(path, CELL)),
    "curve.csv": (run, compared_run),
    "history.csv": (run, compared_run),
    "mesh.msh": (mesh, load_mesh),
}
"""How a file of each kind is written into a folder, and what reads it, by its name."""
UNSEALED = (".msh",)
"""Ends of names of files without a digest of their own."""
