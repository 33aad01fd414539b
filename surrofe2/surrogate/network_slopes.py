"""Slopes of a network by its inputs, by forward differentiation along each of them at once."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from surrofe2.surrogate.network import StressNetwork
from surrofe2.tensors import INPUTS

Array = NDArray[np.float64]


def along(function: Callable[..., Any], at: tuple[Any, ...], direction: tuple[Any, ...]) -> Any:
    """(function(*at), its derivative along a direction), by forward differentiation."""
    with warnings.catch_warnings():
        # torch's own first call of jvp goes through what torch has since deprecated
        warnings.simplefilter("ignore", DeprecationWarning)
        return torch.func.jvp(function, at, direction)


def differentiate(network: StressNetwork, inputs: Array) -> tuple[Array, Array]:
    """(P̂ (n, 4) µN/µm, its slopes (n, 4, 7)) at inputs (n, 7), in the network's precision."""
    count = len(inputs)
    at = torch.as_tensor(inputs, dtype=network.input_scale.dtype).repeat_interleave(INPUTS, dim=0)
    units = torch.eye(INPUTS, dtype=at.dtype).repeat(count, 1)
    with torch.no_grad():
        P, slope = along(network, (at,), (units,))
    values, slopes = (part.double().numpy().reshape(count, INPUTS, 4) for part in (P, slope))
    return values[:, 0].copy(), np.ascontiguousarray(np.swapaxes(slopes, 1, 2))
