"""The polynomial below the network, fitted to stress, and to tangents where there are any.

Linear least squares by the normal equations, accumulated over blocks of samples; directions that
the samples do not see (a range of zero width) get 0, as the solution of least norm has it.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from surrofe2.surrogate.features import STRETCH
from surrofe2.surrogate.network import StressNetwork, products, slope_table
from surrofe2.surrogate.network_slopes import along

_BLOCK = 1024
_LEAST_EIGENVALUE = 1e-13


def fit_baseline(
    network: StressNetwork,
    x: torch.Tensor,
    target: torch.Tensor,
    weight: torch.Tensor,
    slopes: torch.Tensor | None = None,
    slope_weight: float = 0.0,
) -> None:
    """Set the coefficients of the network's baseline.

    Args:
        x: (n, 7) scaled inputs.
        target: (n, 4) components of P̂, µN/µm.
        weight: (4,) of their squared errors.
        slopes: (n, 4, 7) of the target by x, or None.
        slope_weight: of their squared errors, beside that of the stress.
    """
    size = len(network.energy_coefficients) + len(network.coefficients)
    if not size:
        return
    gram, right = np.zeros((size, size)), np.zeros(size)
    owned = _columns_of_components(network)
    for start in range(0, len(x), _BLOCK):
        block = slice(start, start + _BLOCK)
        parts = [(columns(network, x[block]), target[block])]
        if slopes is not None and slope_weight > 0.0:
            parts += _sloped(network, x[block], slopes[block], slope_weight**0.5)
        for matrix, values in parts:
            for k, own in enumerate(owned):
                A = matrix[:, k, own].numpy()
                gram[np.ix_(own, own)] += float(weight[k]) * (A.T @ A)
                right[own] += float(weight[k]) * (A.T @ values[:, k].numpy())
    solution = torch.from_numpy(_solve(gram, right))
    cut = len(network.energy_coefficients)
    network.energy_coefficients.copy_(solution[:cut])
    network.coefficients.copy_(solution[cut:])


def columns(network: StressNetwork, x: torch.Tensor) -> torch.Tensor:
    """(n, 4, m): what a unit of each coefficient, those of the energy first, adds to P̂."""
    f = network.features
    energy = x.new_zeros(len(x), len(f.energy_monomials), STRETCH)
    if f.energy_monomials:
        owner, coefficient, shapes = slope_table(f.energy_monomials)
        values = products(x, shapes) * x.new_tensor([number for _, number in coefficient])
        flat = torch.tensor([3 * k + o for (k, _), o in zip(coefficient, owner, strict=True)])
        energy = energy.reshape(len(x), -1).index_add(1, flat, values).reshape(energy.shape)
    count = len(f.energy_monomials)
    repeated = x[:, :STRETCH].repeat_interleave(count, dim=0)
    elastic = network.elastic(energy.reshape(-1, STRETCH), repeated).reshape(len(x), count, 4)
    rest = x.new_zeros(len(x), len(f.monomials), 4)
    if f.monomials:
        component = torch.nn.functional.one_hot(torch.tensor([k for _, k in f.monomials]), 4)
        rest = component * products(x, [product for product, _ in f.monomials])[:, :, None]
    return torch.cat([elastic, rest], dim=1).transpose(1, 2)


def _columns_of_components(network: StressNetwork) -> list[NDArray[np.intp]]:
    """For each component of P̂ the coefficients it depends on."""
    energy = len(network.energy_coefficients)
    owner = np.array([component for _, component in network.features.monomials], dtype=int)
    shared = np.arange(energy)
    return [np.concatenate([shared, energy + np.flatnonzero(owner == k)]) for k in range(4)]


def _sloped(
    network: StressNetwork, x: torch.Tensor, slopes: torch.Tensor, root: float
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    parts = []
    for k in range(x.shape[1]):
        direction = torch.zeros_like(x)
        direction[:, k] = root
        slope = along(lambda at: columns(network, at), (x,), (direction,))[1]
        parts.append((slope, root * slopes[:, :, k]))
    return parts


def _solve(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(gram / scale[:, None] / scale)
    kept = values > _LEAST_EIGENVALUE * values.max()
    V = vectors[:, kept]
    return (V @ ((V.T @ (right / scale)) / values[kept])) / scale
