"""What the Micro Manager calls of the preCICE library, for tests: one macro participant in a file.

The file `macro.npz` beside the configuration has `vertices` (n, 2) and each vector that is read,
(windows, iterations, n, 2): implicit coupling with a fixed number of iterations a time window of
length 1. All that is written goes to `written-RANK.npz`, in the same shape, NaN at vertices that
are another rank's.
"""

from pathlib import Path

import numpy as np


class Participant:
    def __init__(self, name, configuration, rank, size):
        self.folder, self.rank = Path(configuration).parent, rank
        with np.load(self.folder / "macro.npz") as stored:
            self.given = dict(stored)
        self.vertices = self.given.pop("vertices")
        self.windows, self.iterations = next(iter(self.given.values())).shape[:2]
        self.window = self.iteration = 0
        self.written, self.must_write, self.must_read, self.complete = {}, True, False, False
        self.sections = []

    def get_mesh_dimensions(self, mesh):
        return self.vertices.shape[1]

    def set_mesh_access_region(self, mesh, bounds):
        self.low, self.high = np.reshape(bounds, (-1, 2)).T

    def initialize(self):
        inside = (self.vertices >= self.low) & (self.vertices <= self.high)
        self.ids = np.flatnonzero(inside.all(axis=1))

    def get_mesh_vertex_ids_and_coordinates(self, mesh):
        return self.ids, self.vertices[self.ids]

    def get_max_time_step_size(self):
        return 1.0

    def is_coupling_ongoing(self):
        return self.window < self.windows

    def requires_writing_checkpoint(self):
        asked, self.must_write = self.must_write, False
        return asked

    def requires_reading_checkpoint(self):
        asked, self.must_read = self.must_read, False
        return asked

    def is_time_window_complete(self):
        return self.complete

    def read_data(self, mesh, name, ids, dt):
        assert set(ids) <= set(self.ids)
        return self.given[name][self.window, self.iteration][list(ids)]

    def write_data(self, mesh, name, ids, values):
        assert set(ids) <= set(self.ids)
        values = np.asarray(values, dtype=float)
        if name not in self.written:
            shape = self.windows, self.iterations, len(self.vertices), *values.shape[1:]
            self.written[name] = np.full(shape, np.nan)
        self.written[name][self.window, self.iteration, list(ids)] = values

    def advance(self, dt):
        assert not self.must_write
        assert not self.must_read, "the checkpoint was not put back"
        self.iteration += 1
        self.complete = self.iteration == self.iterations
        self.must_read, self.must_write = not self.complete, self.complete
        if self.complete:
            self.window, self.iteration = self.window + 1, 0

    def start_profiling_section(self, name):
        self.sections.append(name)

    def stop_last_profiling_section(self):
        self.sections.pop()

    def finalize(self):
        np.savez(self.folder / f"written-{self.rank}.npz", **self.written)
