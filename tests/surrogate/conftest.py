"""One surrogate of an analytic law, trained once."""

import pytest
import torch

from surrofe2.surrogate import TrainingSettings, train
from tests.laws import lattice_samples


@pytest.fixture(scope="session", autouse=True)
def one_torch_thread():
    """Small networks gain nothing from more, and sums keep their order."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def samples():
    return lattice_samples(4000)


@pytest.fixture(scope="session")
def settings():
    return TrainingSettings(hidden=(24, 24), baseline_degree=3, iterations=300)


@pytest.fixture(scope="session")
def law(samples, settings):
    return train(samples, settings)
