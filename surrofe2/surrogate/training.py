"""From samples to a `SurrogateLaw`: polynomial by least squares, network by L-BFGS.

The polynomial is fitted to stress, and to tangents where there are any: the normal equations are
accumulated over blocks of samples; directions that the samples do not see get 0. A `Task` holds
what it leaves as tensors, and gives the loss of a network.

Samples with tangents are trained on those as well (Sobolev): the polynomial on all of them, the
network on the slope along one random direction of the inputs per sample. For a network this small
and a stress this smooth, full-batch quasi-Newton steps in float64 reach errors that stochastic
gradients do not in the same time. Samples held out decide nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.base.tensors import INPUTS, to_inputs
from surrofe2.law.samples import StressSamples
from surrofe2.surrogate.domain import fit_domain
from surrofe2.surrogate.features import input_scale
from surrofe2.surrogate.network import Shapes, StressNetwork, along
from surrofe2.surrogate.piola import to_piola, to_slopes
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.surrogate.surrogate_law import SurrogateLaw

Array = NDArray[np.float64]

LEAST_SAMPLES = 20
ROUND = 100
_MANY_UNITS = 300_000
_ITERATIONS_AT_ONCE = 20
_OUTLIER = 8.0  # times the median of what the baseline leaves of a slope: of no use for training
_LEAST_SPREAD = 0.1  # a component of less than this share of the largest counts as one of it
_BLOCK = 1024  # samples
_SMALL = 0.06  # size of a sample by the half widths, below which all count alike
_LEAST_EIGENVALUE = 1e-13
_LISTS = ("old_dirs", "old_stps", "ro")  # of the optimiser: one entry a kept step
_NUMBERS = ("func_evals", "n_iter", "t", "H_diag", "prev_loss")
_VECTORS = ("d", "prev_flat_grad")


@dataclass(frozen=True, eq=False, slots=True)
class TrainingState:
    """An interrupted training: `identity` (fingerprint of the samples and the settings, as text),
    `iterations` done, weights of the network and state of the optimiser by name."""

    identity: Mapping[str, str]
    iterations: int
    arrays: Mapping[str, Array]


Progress = Callable[[int, int, dict[str, float]], None]
ShouldStop = Callable[[SurrogateLaw], bool]
Checkpoint = Callable[[TrainingState], None]


def train(
    samples: StressSamples,
    settings: TrainingSettings,
    *,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    resume: TrainingState | None = None,
    symmetry: str | None = None,
    should_stop: ShouldStop | None = None,
) -> SurrogateLaw:
    """Fit a surrogate to the valid samples; the same seed and threads give the same surrogate.

    Args:
        progress: called with (iterations done, iterations in all, figures), among the figures
            `loss` (training) and `held_out_rms`, both relative to the spread of stress.
        checkpoint: called now and then, and when interrupted by the keyboard.
        resume: a state that `checkpoint` was given.
        symmetry: "D4" or "none"; None: that of the plant cell's arrangement.
        should_stop: says after every `ROUND` iterations whether training is to end, by the
            surrogate so far; None: after all iterations.

    Raises:
        InputError: fewer than `LEAST_SAMPLES` valid samples.
        MismatchError: the state to resume is of other samples or settings.
        SimulationError: the loss is not finite.
    """
    valid = samples.valid
    count = len(valid.F)
    if count < LEAST_SAMPLES:
        raise InputError(f"samples: {count} valid; training needs at least {LEAST_SAMPLES}")
    order = np.random.default_rng(settings.seed).permutation(count)
    kept_out = max(2, round(settings.held_out * count))
    held_out, fitted = order[:kept_out], order[kept_out:]

    data = read_data(valid, settings)
    square = samples.cell.symmetry == "D4"
    network = StressNetwork(settings, symmetry or ("D4" if square else "none"))
    network.input_scale.copy_(torch.from_numpy(input_scale(valid.range)))
    fit_baseline(network, data.at(fitted), settings)
    task, test = (make_task(network, data.at(part), settings) for part in (fitted, held_out))
    set_scale(network, task)
    identity = {"data_fingerprint": samples.fingerprint, "settings": repr(settings)}
    minimisation = _Minimisation(network, settings, identity)
    done = 0 if resume is None else minimisation.restore(resume)
    domain = fit_domain(samples)

    def law() -> SurrogateLaw:
        found = SurrogateLaw(
            network=network.to_parameters(),
            cell=samples.cell,
            initialisation=samples.initialisation,
            range=samples.range,
            settings=settings,
            errors={},
            data_fingerprint=samples.fingerprint,
            rest_length=samples.rest_length,
            version=version("surrofe2"),
            domain=domain,
        )
        return replace(found, errors=found.score(valid.at(held_out)))

    improves = True
    with _threads_for(len(fitted) * max(settings.hidden)):
        while improves and done < settings.iterations:
            at_round = done > 0 and done % ROUND == 0
            if should_stop is not None and at_round and should_stop(law()):
                break
            to = settings.iterations if should_stop is None else done - done % ROUND + ROUND
            done, improves = minimisation.run(task, test, done, to, progress, checkpoint)
    return law()


@contextmanager
def _threads_for(units: int) -> Iterator[None]:
    """One thread of torch where units times samples are few: more would wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1 if units < _MANY_UNITS else before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Minimisation:
    """L-BFGS on the weights of a network."""

    def __init__(
        self, network: StressNetwork, settings: TrainingSettings, identity: Mapping[str, str]
    ) -> None:
        self.network, self.settings, self.identity = network, settings, identity
        self.parameters = list(network.parameters())
        self.optimiser = torch.optim.LBFGS(
            self.parameters,
            history_size=settings.history,
            line_search_fn="strong_wolfe",
            tolerance_grad=0.0,
            tolerance_change=0.0,
        )

    def run(
        self,
        task: Task,
        test: Task,
        done: int,
        to: int,
        progress: Progress | None,
        checkpoint: Checkpoint | None,
    ) -> tuple[int, bool]:
        """Iterate `to` a number or until the loss stalls; (iterations done, whether it falls)."""
        # the first steps of L-BFGS want a loss of order 1
        scale = 1.0 / float((task.weight * self.network.output_scale**2).max())

        def loss_and_gradient() -> torch.Tensor:
            self.optimiser.zero_grad()
            loss = scale * task.loss(self.network)
            loss.backward()
            return loss

        most = self.settings.iterations
        to, state, best = min(to, most), self.snapshot(done), np.inf
        try:
            while done < to:
                count = min(_ITERATIONS_AT_ONCE, to - done)
                self.optimiser.param_groups[0].update(max_iter=count, max_eval=4 * count)
                self.optimiser.step(loss_and_gradient)
                done += count
                figures, loss = self.figures(task, test)
                if not np.isfinite(loss):
                    raise SimulationError(
                        f"training: the loss is not finite after {done} iterations; "
                        "try another seed"
                    )
                if progress is not None:
                    progress(done, most, figures)
                state = self.snapshot(done)
                if checkpoint is not None and done % self.settings.checkpoint_interval < count:
                    checkpoint(state)
                if loss >= best:
                    return done, False
                best = loss
        except KeyboardInterrupt:
            if checkpoint is not None:
                checkpoint(state)
            raise
        return done, True

    def figures(self, task: Task, test: Task) -> tuple[dict[str, float], float]:
        """Errors of stress for the eye, and the loss that is minimised."""
        with torch.no_grad():
            loss = float(task.loss(self.network))
            fitted, held_out = (float(t.stress_loss(self.network)) ** 0.5 for t in (task, test))
        return {"loss": fitted, "held_out_rms": held_out}, loss

    def snapshot(self, done: int) -> TrainingState:
        """All that is needed to carry on after so many iterations."""
        found = {f"network.{k}": v.numpy().copy() for k, v in self.network.state_dict().items()}
        state = self.optimiser.state[self.parameters[0]]
        for name, value in state.items():
            if name in _LISTS:
                found[f"optimiser.{name}"] = torch.stack(value).numpy() if value else np.empty(0)
            elif name in (*_NUMBERS, *_VECTORS):
                values = torch.as_tensor(value, dtype=torch.float64)
                found[f"optimiser.{name}"] = values.numpy().copy()
        return TrainingState(self.identity, done, found)

    def restore(self, state: TrainingState) -> int:
        """Put back what `snapshot` gave; the iterations that were done."""
        for name, value in self.identity.items():
            if state.identity.get(name) != value:
                raise MismatchError(
                    f"training: the state to resume has {name} {state.identity.get(name)}, "
                    f"not {value}"
                )
        try:
            self._put_back(state)
        except (KeyError, TypeError, ValueError, RuntimeError, OverflowError):
            raise MismatchError("training: the state to resume has not what it must") from None
        return state.iterations

    def _put_back(self, state: TrainingState) -> None:
        parts: dict[str, dict[str, Any]] = {"network": {}, "optimiser": {}}
        for name, array in state.arrays.items():
            part, key = name.split(".", 1)
            parts[part][key] = torch.from_numpy(np.array(array))
        self.network.load_state_dict(parts["network"])
        found = parts["optimiser"]
        if not found:
            return
        size, steps = sum(each.numel() for each in self.parameters), len(found["old_dirs"])
        shapes = {"old_dirs": (steps, size), "old_stps": (steps, size), "ro": (steps,)}
        shapes |= dict.fromkeys(_VECTORS, (size,))
        for name, values in found.items():
            single = name in _NUMBERS and values.numel() == 1
            if steps and not single and tuple(values.shape) != shapes[name]:
                raise ValueError(name)
        found |= {name: list(found[name]) for name in _LISTS}
        found |= {name: found[name].item() for name in _NUMBERS}
        found |= {name: int(found[name]) for name in ("func_evals", "n_iter")}
        self.optimiser.state[self.parameters[0]].update(found)


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
    one direction per sample, along which the shapes have the slopes `moving`; both None where there
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
) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    for k in range(x.shape[1]):
        direction = torch.zeros_like(x)
        direction[:, k] = root
        yield along(network.baseline_columns, (x,), (direction,))[1], root * slopes[:, :, k]


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
