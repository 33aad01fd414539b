"""Surrogates of random weights, samples that fail, and twins of what is compiled."""

import json
from dataclasses import replace

import numpy as np
import torch

from surrofe2.base.tensors import INPUTS, to_inputs
from surrofe2.store import surrogates
from surrofe2.store.hdf5 import reading, write
from surrofe2.surrogate import SurrogateLaw, TrainingSettings
from surrofe2.surrogate.domain import (
    Calibration,
    boundary_products,
    fit_domain,
    scale_products,
    scaled_inputs,
    values_of,
)
from surrofe2.surrogate.features import input_scale
from surrofe2.surrogate.network import StressNetwork, along
from surrofe2.surrogate.piola import to_cauchy
from tests.laws import CELL, RANGE, lattice_samples
from tests.numerics import turn

ROTATIONS = [*turn(np.arange(4) * np.pi / 2).round()]
G = [*ROTATIONS, *(each @ np.diag([1.0, -1.0]) for each in ROTATIONS)]
"""The square's group D4."""


def samples_that_fail(fails, count=4000, seed=1):
    """Samples over `RANGE`, failed where fails(inputs (n, 7)) says so."""
    samples = lattice_samples(count, seed)
    failed = fails(to_inputs(samples.F, samples.F_dot)[0])
    status = np.where(failed, 2, 0).astype(np.int8)
    stress = np.where(failed[:, None, None], np.nan, samples.stress)
    return replace(samples, status=status, stress=stress)


def buckles(x):
    """Compression beyond a curved limit, a little earlier while compressing further."""
    sum_U, difference, shear, rate = x[:, 0], x[:, 1], x[:, 2], x[:, 3]
    return sum_U + 2.0 * rate < -0.07 + 2.0 * difference**2 + 1.5 * shear**2


def make_network(symmetry="D4", hidden=(6, 5), degree=3):
    """A torch network of random weights, all of which matter."""
    settings = TrainingSettings(hidden=hidden, baseline_degree=degree, seed=2)
    network = StressNetwork(settings, symmetry)
    network.second_order = True
    generator = torch.Generator().manual_seed(4)
    network.input_scale.copy_(torch.from_numpy(input_scale(RANGE)))
    network.output_scale.copy_(torch.tensor([1.0, 2.0, 3.0, 4.0]))
    network.coefficients.normal_(generator=generator)
    return network


def make_law(symmetry="D4", network=None):
    """A law of random weights, in the middle of whose range the tests stay."""
    network = network or make_network(symmetry)
    return SurrogateLaw(
        network=network.to_parameters(), cell=CELL, initialisation="elastic", range=RANGE,
        settings=network.settings, errors={}, data_fingerprint="",
    )  # fmt: skip


def with_bound(law, quantile=0.7):
    """The law with a domain that has a failure boundary and an arbitrary bound."""
    scale = np.random.default_rng(0).uniform(0.0, 1.0, len(scale_products()))
    scale[3:9] = 0.0
    calibration = Calibration(
        scale=scale,
        quantile=quantile,
        alpha=0.01,
        confidence=0.95,
        kinds={},
        stress_spread=10.0,
        data_fingerprint=law.data_fingerprint,
        subject=law.network.fingerprint(law.range),
        settings={},
        near=np.array([0.3, 0.25, 0.2, 0.1, 0.05, 0.06, 0.04]),
    )
    domain = fit_domain(samples_that_fail(buckles, 2000))
    return replace(law, domain=domain, calibration=calibration)


def within(domain, F, F_dot):
    """(n,) whether points (n, 2, 2) are short of the failure boundary."""
    if not len(domain.boundary):
        return np.ones(len(F), dtype=bool)
    x = scaled_inputs(F, F_dot, domain.scale)
    height = values_of(boundary_products(domain.square), x, np.zeros(INPUTS)) @ domain.boundary
    return height <= 0.0


def torch_stress(law, F, F_dot):
    """Stress (n, 2, 2) of a surrogate by its torch network, in range or not."""
    network = StressNetwork(law.settings, law.network.symmetry)
    tensors = law.network.tensors.items()
    network.load_state_dict({name: torch.from_numpy(values) for name, values in tensors})
    return network_stress(network, F, F_dot)


def network_stress(network, F, F_dot):
    """Stress (n, 2, 2) of a torch network."""
    with torch.no_grad():
        return to_cauchy(F, network(torch.from_numpy(to_inputs(F, F_dot)[0])).numpy())


def differentiate(network, inputs):
    """(P̂ (n, 4) µN/µm, its slopes (n, 4, 7)) at inputs (n, 7), by forward differentiation."""
    count = len(inputs)
    at = torch.from_numpy(inputs).repeat_interleave(INPUTS, dim=0)
    units = torch.eye(INPUTS, dtype=at.dtype).repeat(count, 1)
    with torch.no_grad():
        P, slope = along(network, (at,), (units,))
    values, slopes = (part.numpy().reshape(count, INPUTS, 4) for part in (P, slope))
    return values[:, 0].copy(), np.swapaxes(slopes, 1, 2)


def read_parts(path):
    """(header, arrays) of a surrogate's file; tables of the header opened."""
    with reading(path, surrogates.SURROGATE) as stored:
        header = dict(stored.file.attrs)
        for name, value in header.items():
            if str(value).startswith("{"):
                header[name] = json.loads(value)
        return header, stored.arrays()


def write_parts(path, header, arrays):
    """A file of these parts, with the right SHA-256."""
    own = ("sha256", "schema", "schema_version")
    header = {key: value for key, value in header.items() if key not in own}
    write(path, surrogates.SURROGATE, header, arrays)
