"""A data set of the soft law, written in chunks."""

from surrofe2.base.sampling import SamplingRange, sample
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.store.samples import DataSetHeader, writing_data_set
from tests.laws import SoftLaw

RANGE = SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=0.01)
HEADER = DataSetHeader(
    cell=CellParameters(),
    rve={"initialisation": "constrained-runs", "solver": "direct", "tolerance": 1e-8},
    range=RANGE,
    count=20,
    seed=3,
    chunk=8,
    version="0.1.0",
    recipe={"recipe": "recipe.toml"},
    rest_length=1.5,
)


def append_chunk(data, law):
    start = data.completed
    F, F_dot = sample(RANGE, min(8, HEADER.count - start), 3, start=start)
    answer = law.respond(F, F_dot)
    data.append(F, F_dot, answer)


def write_all(path, fails_above=1.03):
    law = SoftLaw(fails_above=fails_above)
    with writing_data_set(path, HEADER) as data:
        while data.completed < HEADER.count:
            append_chunk(data, law)
        data.finish()
