"""What a network is trained on: its polynomial baseline, and a `Task` of what that leaves.

The baseline is fitted to stress, and to tangents where there are any, by linear least squares: the
normal equations are accumulated over blocks of samples; directions that the samples do not see (a
range of zero width) get 0, as the solution of least norm has it. A `Task` holds the rest as
tensors, one row a sample, and gives the loss of a network.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from surrofe2.base.tensors import INPUTS, to_inputs
from surrofe2.law.samples import StressSamples
from surrofe2.surrogate.features import input_scale
from surrofe2.surrogate.network import Shapes, StressNetwork, along
from surrofe2.surrogate.piola import to_piola, to_slopes
from surrofe2.surrogate.settings import TrainingSettings

_OUTLIER = 8.0  # times the median of what the baseline leaves of a slope: of no use for training
_LEAST_SPREAD = 0.1  # a component of less than this share of the largest counts as one of it
_BLOCK = 1024  # samples
_SMALL = 0.06  # size of a sample by the half widths, below which all count alike
_LEAST_EIGENVALUE = 1e-13


@dataclass(frozen=True)
class Data:
    """Scaled inputs (n, 7), P̂ (n, 4) and, where the samples have tangents, its slopes by x.

    rest: (4, 7) the slopes at rest, which hold exactly; None where no sample is at rest.
    """

    x: torch.Tensor
    target: torch.Tensor
    slopes: torch.Tensor | None
    rest: torch.Tensor | None

    def at(self, chosen: NDArray[np.int64]) -> Data:
        """Those of the samples with these numbers."""
        slopes = None if self.slopes is None else self.slopes[chosen]
        return Data(self.x[chosen], self.target[chosen], slopes, self.rest)


def read_data(samples: StressSamples, settings: TrainingSettings) -> Data:
    """The tensors of valid samples; slopes only where the settings give them a weight."""
    inputs, _ = to_inputs(samples.F, samples.F_dot)
    scale = input_scale(samples.range)
    target = torch.from_numpy(to_piola(samples.F, samples.stress))
    by_F, by_rate = samples.P_by_F, samples.P_by_F_dot
    slopes = rest = None
    if by_F is not None and by_rate is not None:
        known = torch.from_numpy(to_slopes(samples.F, by_F, by_rate) * scale)
        at_rest = np.flatnonzero((inputs == 0.0).all(axis=1))
        rest = known[at_rest[0]] if len(at_rest) else None
        slopes = known if settings.tangent_weight > 0.0 else None
    return Data(torch.from_numpy(inputs / scale), target, slopes, rest)


@dataclass(frozen=True)
class Task:
    """What a network is to add to the baseline, and the matrices that take it to Cauchy stress.

    `weight` (4,): of the squared error of a component of S = Rᵀ σ R. `slope` (n, 4): of P̂ along
    one direction a sample, along which the shapes have the slopes `moving`; both None where there
    are no tangents. `slope_weight` (n, 1): of its squared error, 0 at outliers. `share` (n, 1): of
    a sample in the loss, of mean 1.
    """

    shapes: Shapes
    target: torch.Tensor
    to_cauchy: torch.Tensor
    weight: torch.Tensor
    share: torch.Tensor
    moving: Shapes | None = None
    slope: torch.Tensor | None = None
    slope_weight: torch.Tensor | float = 0.0

    def loss(self, network: StressNetwork) -> torch.Tensor:
        """Mean square error relative to the spread of each component, with that of slopes.

        Samples count by their size to the power of −2.5, so that the error tends to be a share of
        the stress and smallest near rest, where a wave has its phase from.
        """
        if self.moving is None or self.slope is None:
            squares = self._squares(network.correction(self.shapes) - self.target)
        else:
            found, slope = network.correction_along(self.shapes, self.moving)
            squares = self._squares(found - self.target)
            squares = squares + self.slope_weight * self._squares(slope - self.slope)
        return (self.share * squares).mean()

    def _squares(self, error: torch.Tensor) -> torch.Tensor:
        cauchy = torch.matmul(self.to_cauchy, error[:, :, None])[:, :, 0]
        return cauchy**2 * self.weight

    def stress_loss(self, network: StressNetwork) -> torch.Tensor:
        """The mean square error of stress alone, each sample counted once."""
        return self._squares(network.correction(self.shapes) - self.target).mean()


def fit_baseline(network: StressNetwork, data: Data, settings: TrainingSettings) -> None:
    """Set the coefficients of the network's baseline, each component relative to its spread."""
    size = len(network.coefficients)
    if not size:
        return
    weight = 1.0 / _spread(data.target) ** 2
    gram, right = np.zeros((size, size)), np.zeros(size)
    owner = np.array([component for _, component in network.features.monomials], dtype=int)
    owned = [np.flatnonzero(owner == k) for k in range(4)]
    for start in range(0, len(data.x), _BLOCK):
        block = slice(start, start + _BLOCK)
        x = data.x[block]
        parts = [(network.baseline_columns(x), data.target[block])]
        if data.slopes is not None and settings.tangent_weight > 0.0:
            parts += _sloped(network, x, data.slopes[block], settings.tangent_weight**0.5)
        for matrix, values in parts:
            for k, own in enumerate(owned):
                A = matrix[:, k, own].numpy()
                gram[np.ix_(own, own)] += float(weight[k]) * (A.T @ A)
                right[own] += float(weight[k]) * (A.T @ values[:, k].numpy())
    network.second_order = data.rest is not None
    fixed = np.full(size, np.nan) if data.rest is None else network.rest_coefficients(data.rest)
    known = np.isfinite(fixed)
    right -= gram[:, known] @ fixed[known]
    free = np.flatnonzero(~known)
    if len(free):
        fixed[free] = _solve(gram[np.ix_(free, free)], right[free])
    network.coefficients.copy_(torch.from_numpy(fixed))


def _sloped(
    network: StressNetwork, x: torch.Tensor, slopes: torch.Tensor, root: float
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    parts = []
    for k in range(x.shape[1]):
        direction = torch.zeros_like(x)
        direction[:, k] = root
        slope = along(network.baseline_columns, (x,), (direction,))[1]
        parts.append((slope, root * slopes[:, :, k]))
    return parts


def _solve(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(gram / scale[:, None] / scale)
    kept = values > _LEAST_EIGENVALUE * values.max()
    V = vectors[:, kept]
    return (V @ ((V.T @ (right / scale)) / values[kept])) / scale


def _spread(target: torch.Tensor) -> torch.Tensor:
    spread = target.std(dim=0)
    return spread.clamp(min=max(_LEAST_SPREAD * float(spread.max()), np.finfo(float).tiny))


def make_task(network: StressNetwork, data: Data, settings: TrainingSettings) -> Task:
    """What the polynomial of the network leaves of the data."""
    to_cauchy = network.to_cauchy(data.x)
    share = (data.x.square().mean(dim=1, keepdim=True).sqrt() + _SMALL) ** -2.5
    task = Task(
        shapes=network.shapes(data.x),
        target=data.target - network.baseline(data.x),
        to_cauchy=to_cauchy,
        weight=1.0 / _spread(torch.einsum("nij,nj->ni", to_cauchy, data.target)) ** 2,
        share=share / share.mean(),
    )
    if data.slopes is None:
        return task
    directions = np.random.default_rng(settings.seed).standard_normal((len(data.x), INPUTS))
    direction = torch.from_numpy(directions)
    below = along(network.baseline, (data.x,), (direction,))[1]
    slope = torch.einsum("nkj,nj->nk", data.slopes, direction) - below
    moving = along(network.shapes, (data.x,), (direction,))[1]
    weight = settings.tangent_weight * _typical(task, slope)
    return replace(task, moving=moving, slope=slope, slope_weight=weight)


def _typical(task: Task, slope: torch.Tensor) -> torch.Tensor:
    """(n, 1): 0 where a slope is an outlier, else 1.

    Where a pair of particles is about to cross the cut-off, the tangent of the slow manifold is
    exact for steps of F of some 1e-5 and off for all others; a few such steer a whole network.
    """
    size = task._squares(slope).sum(dim=1, keepdim=True).sqrt()
    return (size <= _OUTLIER * size.median()).to(slope.dtype)


def set_scale(network: StressNetwork, task: Task) -> None:
    """Set the scale by which outputs of order 1 give what the baseline leaves."""
    typical = (task.target**2).mean(dim=0).sqrt()
    network.output_scale.copy_(typical.maximum(1e-9 / task.weight.sqrt()))
