"""Surrogates of random weights, and what random weights may know of their data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from surrofe2.surrogate import SurrogateLaw, TrainingSettings
from surrofe2.surrogate.domain import Calibration, fit_domain, scale_products
from surrofe2.surrogate.features import input_scale
from surrofe2.surrogate.network import StressNetwork
from tests.laws import CELL, RANGE
from tests.surrogate.failing_samples import buckles, samples_that_fail


def make_network(symmetry="D4"):
    """A torch network of random weights."""
    settings = TrainingSettings(hidden=(6, 5), baseline_degree=3, seed=2)
    network = StressNetwork(settings, symmetry)
    generator = torch.Generator().manual_seed(4)
    network.input_scale.copy_(torch.from_numpy(input_scale(RANGE)))
    network.coefficients.normal_(generator=generator)
    return network


def make_law(symmetry="D4"):
    """A law of random weights, in the middle of whose range the tests stay."""
    network = make_network(symmetry)
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
