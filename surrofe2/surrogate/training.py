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

from surrofe2.base.arrays import Array, Index
from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.base.tensors import INPUTS, to_inputs
from surrofe2.law.samples import StressSamples
from surrofe2.surrogate.domain import fit_domain
from surrofe2.surrogate.features import COMPONENTS, input_scale
from surrofe2.surrogate.network import Shapes, StressNetwork, along
from surrofe2.surrogate.piola import to_piola, to_slopes
from surrofe2.surrogate.settings import TrainingSettings
from surrofe2.surrogate.surrogate_law import SurrogateLaw

LEAST_SAMPLES = 20
ROUND = 100
_MANY_UNITS = 300_000
_ITERATIONS_AT_ONCE = 20
_OUTLIER = 8.0  # times the median of what the baseline leaves of a slope: of no use for training
_LEAST_SPREAD = 0.1  # a component of less than this share of the largest counts as one of it
_BLOCK = 1024  # samples
_SMALL = 0.06  # size of a sample by the half widths, below which all count alike
_LEAST_EIGENVALUE = 1e-13
_LISTS = ("old_dirs", "old_stps", "ro")  # of the optimiser: one entry an accepted step
_NUMBERS = ("func_evals", "n_iter", "t", "H_diag", "prev_loss")
_VECTORS = ("d", "prev_flat_grad")


@dataclass(frozen=True, eq=False, slots=True)
class TrainingState:
    """An interrupted training: `identity` (fingerprint of the samples and the settings, as text),
    `iterations` done, weights of the network and state of the optimiser by name."""

    identity: Mapping[str, str]
    iterations: int
    arrays: Mapping[str, Array]


@contextmanager
def usual_torch() -> Iterator[None]:
    """torch as it is in a new process: on the CPU, with gradients, with its own default type.

    What the caller has set (a default device or type, no gradients, inference mode) holds again
    after the block.
    """
    dtype = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        with torch.device("cpu"), torch.inference_mode(False), torch.enable_grad():
            yield
    finally:
        torch.set_default_dtype(dtype)


@usual_torch()
def train(
    samples: StressSamples,
    settings: TrainingSettings,
    *,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
    checkpoint: Callable[[TrainingState], None] | None = None,
    resume: TrainingState | None = None,
    symmetry: str | None = None,
    should_stop: Callable[[SurrogateLaw], bool] | None = None,
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
    # outputs of order 1 give what the baseline leaves
    typical = (task.target**2).mean(dim=0).sqrt()
    network.output_scale.copy_(typical.maximum(1e-9 / task.weight.sqrt()))
    optimiser = torch.optim.LBFGS(
        network.parameters(),
        history_size=settings.history,
        line_search_fn="strong_wolfe",
        tolerance_grad=0.0,
        tolerance_change=0.0,
    )
    identity = {"data_fingerprint": samples.fingerprint, "settings": repr(settings)}
    done = 0 if resume is None else _restore(resume, identity, network, optimiser)
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

    # the first steps of L-BFGS want a loss of order 1
    scale = 1.0 / float((task.weight * network.output_scale**2).max())

    def loss_and_gradient() -> torch.Tensor:
        optimiser.zero_grad()
        loss = scale * task.loss(network)
        loss.backward()
        return loss

    state, least = _snapshot(identity, done, network, optimiser), np.inf
    threads = torch.get_num_threads()
    if len(fitted) * max(settings.hidden) < _MANY_UNITS:
        torch.set_num_threads(1)  # more would wait for each other
    try:
        while done < settings.iterations:
            if should_stop is not None and done > 0 and done % ROUND == 0 and should_stop(law()):
                break
            count = min(_ITERATIONS_AT_ONCE, settings.iterations - done)
            optimiser.param_groups[0].update(max_iter=count, max_eval=4 * count)
            optimiser.step(loss_and_gradient)
            done += count
            with torch.no_grad():
                loss = float(task.loss(network))
                fitted_rms, held_out_rms = (
                    float(each.stress_loss(network)) ** 0.5 for each in (task, test)
                )
            if not np.isfinite(loss):
                raise SimulationError(
                    f"training: the loss is not finite after {done} iterations; try another seed"
                )
            if progress is not None:
                figures = {"loss": fitted_rms, "held_out_rms": held_out_rms}
                progress(done, settings.iterations, figures)
            state = _snapshot(identity, done, network, optimiser)
            if checkpoint is not None and done % settings.checkpoint_interval < count:
                checkpoint(state)
            if loss >= least:
                break
            least = loss
    except KeyboardInterrupt:
        if checkpoint is not None:
            checkpoint(state)
        raise
    finally:
        torch.set_num_threads(threads)
    return law()


def _snapshot(
    identity: Mapping[str, str], done: int, network: StressNetwork, optimiser: torch.optim.LBFGS
) -> TrainingState:
    """All that is needed to carry on after so many iterations."""
    arrays = {f"network.{k}": v.numpy().copy() for k, v in network.state_dict().items()}
    for name, value in optimiser.state[next(network.parameters())].items():
        if name in _LISTS:
            arrays[f"optimiser.{name}"] = torch.stack(value).numpy() if value else np.empty(0)
        elif name in (*_NUMBERS, *_VECTORS):
            number = torch.as_tensor(value, dtype=torch.float64)
            arrays[f"optimiser.{name}"] = number.numpy().copy()
    return TrainingState(identity, done, arrays)


def _restore(
    state: TrainingState,
    identity: Mapping[str, str],
    network: StressNetwork,
    optimiser: torch.optim.LBFGS,
) -> int:
    """Put back what `_snapshot` gave; the iterations that were done."""
    for name, value in identity.items():
        if state.identity.get(name) != value:
            raise MismatchError(
                f"training: the state to resume has {name} {state.identity.get(name)}, not {value}"
            )
    parts: dict[str, dict[str, Any]] = {"network": {}, "optimiser": {}}
    try:
        for name, array in state.arrays.items():
            part, key = name.split(".", 1)
            parts[part][key] = torch.from_numpy(np.array(array))
        network.load_state_dict(parts["network"])
        if found := parts["optimiser"]:
            size, steps = sum(each.numel() for each in network.parameters()), len(found["ro"])
            shapes = {"old_dirs": (steps, size), "old_stps": (steps, size), "ro": (steps,)}
            shapes |= dict.fromkeys(_VECTORS, (size,)) | dict.fromkeys(_NUMBERS, ())
            known = {name: found[name].reshape(shape) for name, shape in shapes.items()}
            known |= {name: list(known[name]) for name in _LISTS}
            known |= {name: known[name].item() for name in _NUMBERS}
            known |= {name: int(known[name]) for name in ("func_evals", "n_iter")}
            optimiser.state[next(network.parameters())].update(known)
    except (KeyError, TypeError, ValueError, RuntimeError, OverflowError):
        raise MismatchError("training: the state to resume has not what it must") from None
    return state.iterations


@dataclass(frozen=True)
class Data:
    """Scaled inputs (n, 7), P̂ (n, 4) and, where the samples have tangents, its slopes by x.

    rest: (4, 7) the slopes at rest, which hold exactly; None where no sample is at rest.
    """

    x: torch.Tensor
    target: torch.Tensor
    slopes: torch.Tensor | None
    rest: torch.Tensor | None

    def at(self, chosen: Index) -> Data:
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
    one direction per sample, along which the shapes have the slopes `moving`. `slope_weight`
    (n, 1): of its squared error, 0 at outliers; these three are None where there are no tangents.
    `share` (n, 1): of a sample in the loss, of mean 1.
    """

    shapes: Shapes
    target: torch.Tensor
    to_cauchy: torch.Tensor
    weight: torch.Tensor
    share: torch.Tensor
    moving: Shapes | None = None
    slope: Any = None
    slope_weight: Any = None

    def loss(self, network: StressNetwork) -> torch.Tensor:
        """Mean square error relative to the spread of each component, with that of slopes.

        Samples count by their size to the power of −2.5, so that the error tends to be a fraction
        of the stress and smallest near rest, where a wave has its phase from.
        """
        P, slope = network.correction(self.shapes, self.moving)
        squares = self.squares(P - self.target)
        if slope is not None:
            squares = squares + self.slope_weight * self.squares(slope - self.slope)
        return (self.share * squares).mean()

    def stress_loss(self, network: StressNetwork) -> torch.Tensor:
        """The mean square error of stress alone, each sample counted once."""
        return self.squares(network.correction(self.shapes)[0] - self.target).mean()

    def squares(self, error: torch.Tensor) -> torch.Tensor:
        """(n, 4) of errors of P̂, weighted."""
        cauchy = torch.matmul(self.to_cauchy, error[:, :, None])[:, :, 0]
        return cauchy**2 * self.weight


def fit_baseline(network: StressNetwork, data: Data, settings: TrainingSettings) -> None:
    """Set the coefficients of the network's baseline, each component relative to its spread."""
    size, owner = len(network.coefficients), network.owner.numpy()
    weight = 1.0 / _spread(data.target).numpy() ** 2
    gram, right = np.zeros((size, size)), np.zeros(size)
    for start in range(0, len(data.x) if size else 0, _BLOCK):
        block = slice(start, start + _BLOCK)
        x = data.x[block]
        parts = [(network.monomials(x), data.target[block])]
        if data.slopes is not None:
            root = settings.tangent_weight**0.5
            for k, unit in enumerate(torch.eye(INPUTS, dtype=x.dtype)):
                steeper = along(network.monomials, (x,), (unit.expand_as(x),))[1]
                parts.append((root * steeper, root * data.slopes[block, :, k]))
        for matrix, values in parts:
            for k in range(COMPONENTS):
                own = np.flatnonzero(owner[:, k])
                A = matrix[:, own].numpy()
                gram[np.ix_(own, own)] += weight[k] * (A.T @ A)
                right[own] += weight[k] * (A.T @ values[:, k].numpy())
    network.second_order = data.rest is not None
    fixed = np.full(size, np.nan) if data.rest is None else network.rest_coefficients(data.rest)
    free = np.isnan(fixed)
    right -= gram[:, ~free] @ fixed[~free]
    scale = np.sqrt(np.maximum(np.diag(gram)[free], np.finfo(float).tiny))
    A = gram[np.ix_(free, free)] / scale[:, None] / scale
    fixed[free] = np.linalg.lstsq(A, right[free] / scale, rcond=_LEAST_EIGENVALUE)[0] / scale
    network.coefficients.copy_(torch.from_numpy(fixed))


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
    # Where a pair of particles is about to cross the cut-off, the tangent of the slow manifold is
    # exact for steps of F of some 1e-5 and off for all others; a few such steer a whole network.
    size = task.squares(slope).sum(dim=1, keepdim=True).sqrt()
    is_usual = (size <= _OUTLIER * size.median()).to(slope.dtype)
    moving = along(network.shapes, (data.x,), (direction,))[1]
    weight = settings.tangent_weight * is_usual
    return replace(task, moving=moving, slope=slope, slope_weight=weight)
