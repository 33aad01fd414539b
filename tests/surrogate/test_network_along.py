"""What a network gives along a direction, written out, is what torch differentiates."""

from __future__ import annotations

import pytest
import torch

from surrofe2.surrogate.network import Shapes, along
from tests.surrogate.networks import make_network


@pytest.mark.parametrize("symmetry", ["D4", "none"])
@pytest.mark.parametrize("second_order", [True, False])
def test_correction_and_its_slope(symmetry, second_order):
    network = make_network(symmetry)
    network.second_order = second_order
    generator = torch.Generator().manual_seed(6)
    x, direction = torch.randn((2, 20, 7), generator=generator, dtype=torch.float64)
    shapes, moving = along(network.shapes, (x,), (direction,))
    found = network.correction_along(shapes, moving)
    expected = along(lambda *at: network.correction(Shapes(*at)), shapes, moving)
    for part, wanted in zip(found, expected, strict=True):
        torch.testing.assert_close(part, wanted, rtol=1e-12, atol=1e-12)
    assert expected[1].abs().max() > 1e-3
