"""Training of a `SurrogateLaw` by samples: polynomial by least squares, network by L-BFGS.

The polynomial is fitted to stress, and to tangents where there are any: the normal equations are
accumulated over blocks of samples; directions that the samples do not see get 0. A `Task` holds as
tensors what the polynomial leaves of the samples, and computes the loss of a network.

Samples with tangents are trained on those as well (Sobolev): the polynomial on all of them, the
network on the slope along one random direction of the inputs per sample. For a network this small
and a stress this smooth, full-batch quasi-Newton steps in float64 reach errors that stochastic
gradients do not in the same time. Samples held out decide nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
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
"""Iterations between two questions whether training is to end."""
# Samples times units of a layer, below which several threads would wait for each other.
_MANY_UNITS = 300_000
# Iterations of one call of the optimiser. The loss is looked at, and the state taken, in between.
_ITERATIONS_AT_ONCE = 20
# What the baseline leaves of a slope counts as an outlier beyond so many times the median.
_OUTLIER = 8.0
# The spread of a component is taken as no less than this fraction of the largest: a component that
# is nearly zero must not be fitted to its last digit.
_LEAST_SPREAD = 0.1
# Samples of which the monomials are held in memory at once.
_BLOCK = 1024
# Size of a sample, as a fraction of the half widths, below which all count alike.
_SMALL = 0.06
# Directions of the normal equations below this fraction of the largest are rounding.
_LEAST_EIGENVALUE = 1e-13
# Names in the state of torch's L-BFGS, by the shape of what they name.
_LISTS = ("old_dirs", "old_stps", "ro")  # one entry for each accepted step
_NUMBERS = ("func_evals", "n_iter", "t", "H_diag", "prev_loss")
_VECTORS = ("d", "prev_flat_grad")  # one entry for each weight


@dataclass(frozen=True, eq=False, slots=True)
class TrainingState:
    """An interrupted training, from which `train` resumes to the same result.

    Attributes:
        identity: fingerprint of the samples and the settings, as text; a training with others does
            not resume from this state.
        iterations: iterations done.
        arrays: weights of the network and state of the optimiser, by name.
    """

    identity: Mapping[str, str]
    iterations: int
    arrays: Mapping[str, Array]


@contextmanager
def usual_torch() -> Iterator[None]:
    """Run a block with torch as in a new process: on the CPU, with gradients, by default type.

    What the caller has set (a default device or type, no gradients, inference mode) holds again
    after the block.
    """
    cpu = torch.device("cpu")
    # a device that is in force is asked at each operation, which takes a sixth of the training
    on_cpu = nullcontext() if torch.get_default_device() == cpu else cpu
    dtype = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        with on_cpu, torch.inference_mode(False), torch.enable_grad():
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

    Examples:
        A small network learns from few samples; more of both belong to a study:

        >>> from surrofe2 import RveLaw, SamplingRange, TrainingSettings, sample_stress, train
        >>> range = SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=1e-3)
        >>> samples = sample_stress(RveLaw("apple"), range, 64)
        >>> surrogate = train(samples, TrainingSettings(hidden=(8,), iterations=20))
        >>> surrogate.score(samples)["rms"]["xy"] < 0.01  # of the stresses' standard deviation
        True
    """
    valid = samples.valid
    count = len(valid.F)
    if count < LEAST_SAMPLES:
        raise InputError(f"samples: {count} valid; training needs at least {LEAST_SAMPLES}")
    order = np.random.default_rng(settings.seed).permutation(count)
    held_out_count = max(2, round(settings.held_out * count))  # a spread needs two
    held_out = order[:held_out_count]
    fitted = order[held_out_count:]

    data = read_data(valid, settings)
    if symmetry is None:
        symmetry = "D4" if samples.cell.symmetry == "D4" else "none"
    network = StressNetwork(settings, symmetry)
    network.input_scale.copy_(torch.from_numpy(input_scale(valid.range)))
    fit_baseline(network, data.at(fitted), settings)
    task = make_task(network, data.at(fitted), settings)
    test = make_task(network, data.at(held_out), settings)
    # Outputs of order 1 then give what the baseline leaves. A component that it fits exactly leaves
    # nothing, and a scale of 0 would take the component out of the network for good.
    typical = (task.target**2).mean(dim=0).sqrt()
    network.output_scale.copy_(typical.maximum(1e-9 / task.weight.sqrt()))
    # L-BFGS ends by the iterations alone; its own thresholds are absolute and fit no scale.
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
        """Make the surrogate of the weights as they are, with its errors on held-out samples."""
        surrogate = SurrogateLaw(
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
        return replace(surrogate, errors=surrogate.score(valid.at(held_out)))

    # the first steps of L-BFGS want a loss of order 1
    scale = 1.0 / float((task.weight * network.output_scale**2).max())

    def loss_and_gradient() -> torch.Tensor:
        """Compute the scaled loss, and leave its gradient with the weights, for L-BFGS."""
        optimiser.zero_grad()
        loss = scale * task.loss(network)
        loss.backward()
        return loss

    state = _snapshot(identity, done, network, optimiser)
    least_loss = np.inf
    threads = torch.get_num_threads()
    if len(fitted) * max(settings.hidden) < _MANY_UNITS:
        torch.set_num_threads(1)
    try:
        while done < settings.iterations:
            is_round = done > 0 and done % ROUND == 0
            if should_stop is not None and is_round and should_stop(law()):
                break
            count = min(_ITERATIONS_AT_ONCE, settings.iterations - done)
            # a line search takes one or two evaluations; 4 is what it may take at most on average
            optimiser.param_groups[0].update(max_iter=count, max_eval=4 * count)
            optimiser.step(loss_and_gradient)
            done += count
            with torch.no_grad():
                loss = float(task.loss(network))
                fitted_rms = float(task.stress_loss(network)) ** 0.5
                held_out_rms = float(test.stress_loss(network)) ** 0.5
            if not np.isfinite(loss):
                raise SimulationError(
                    f"training: the loss is not finite after {done} iterations; try another seed"
                )
            if progress is not None:
                figures = {"loss": fitted_rms, "held_out_rms": held_out_rms}
                progress(done, settings.iterations, figures)
            state = _snapshot(identity, done, network, optimiser)
            has_passed_interval = done % settings.checkpoint_interval < count
            if checkpoint is not None and has_passed_interval:
                checkpoint(state)
            if loss >= least_loss:  # the line search makes no more progress
                break
            least_loss = loss
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
    """Take all that is needed to resume after so many iterations."""
    arrays = {f"network.{k}": v.numpy().copy() for k, v in network.state_dict().items()}
    # torch keeps the state of L-BFGS under the first parameter
    for name, value in optimiser.state[next(network.parameters())].items():
        if name in _LISTS:
            # torch stacks no empty list
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
    """Put back what `_snapshot` took, and return the iterations that were done.

    Raises:
        MismatchError: the state is of other samples or settings, or not whole.
    """
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
        stored = parts["optimiser"]
        if stored:  # empty: interrupted before the first step
            size = sum(values.numel() for values in network.parameters())
            optimiser.state[next(network.parameters())].update(_optimiser_state(stored, size))
    except (KeyError, TypeError, ValueError, RuntimeError, OverflowError):
        raise MismatchError("training: the state to resume has not what it must") from None
    return state.iterations


def _optimiser_state(stored: Mapping[str, torch.Tensor], size: int) -> dict[str, Any]:
    """Return the state of L-BFGS for `size` weights from tensors, in the types that torch keeps.

    Tensors of wrong size raise as `reshape` does.
    """
    steps = len(stored["ro"])
    state: dict[str, Any] = {
        "old_dirs": list(stored["old_dirs"].reshape(steps, size)),
        "old_stps": list(stored["old_stps"].reshape(steps, size)),
        "ro": list(stored["ro"].reshape(steps)),
    }
    for name in _VECTORS:
        state[name] = stored[name].reshape(size)
    for name in _NUMBERS:
        state[name] = stored[name].reshape(()).item()
    for name in ("func_evals", "n_iter"):  # counts, which are stored as floats
        state[name] = int(state[name])
    return state


@dataclass(frozen=True)
class Data:
    """The samples as tensors.

    Attributes:
        x: (n, 7) scaled inputs.
        target: (n, 4) components of P̂, µN/µm.
        slopes: (n, 4, 7) slopes of P̂ by x, µN/µm; None where the samples have no tangents.
        rest: (4, 7) slopes at rest, which hold exactly; None where no sample is at rest.
    """

    x: torch.Tensor
    target: torch.Tensor
    slopes: torch.Tensor | None
    rest: torch.Tensor | None

    def at(self, chosen: Index) -> Data:
        """Return the data of the samples with these numbers."""
        slopes = None if self.slopes is None else self.slopes[chosen]
        return Data(self.x[chosen], self.target[chosen], slopes, self.rest)


def read_data(samples: StressSamples, settings: TrainingSettings) -> Data:
    """Make the tensors of valid samples, with slopes where the settings give them a weight."""
    inputs, _ = to_inputs(samples.F, samples.F_dot)
    scale = input_scale(samples.range)
    target = torch.from_numpy(to_piola(samples.F, samples.stress))
    slopes = None
    rest = None
    if samples.P_by_F is not None and samples.P_by_F_dot is not None:
        all_slopes = to_slopes(samples.F, samples.P_by_F, samples.P_by_F_dot)
        known = torch.from_numpy(all_slopes * scale)
        at_rest = np.flatnonzero((inputs == 0.0).all(axis=1))
        if len(at_rest):
            rest = known[at_rest[0]]
        if settings.tangent_weight > 0.0:
            slopes = known
    return Data(torch.from_numpy(inputs / scale), target, slopes, rest)


@dataclass(frozen=True)
class Task:
    """The part of the data that a network is to add to the baseline, and its loss.

    Attributes:
        shapes: arguments of the network at the n samples.
        target: (n, 4) components of P̂ that the baseline leaves, µN/µm.
        to_cauchy: (n, 4, 4) matrices that take components of P̂ to those of S = Rᵀ σ R.
        weight: (4,) weight of the squared error of each component of S.
        share: (n, 1) weight of a sample in the loss; the mean is 1.
        moving: slopes of `shapes` along one random direction per sample; None, with the two that
            follow, where there are no tangents.
        slope: (n, 4) slope of P̂ along this direction that the baseline leaves, µN/µm.
        slope_weight: (n, 1) weight of the slope's squared error, 0 at outliers.
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
        """Compute the mean square error of stress and slopes, relative to each spread.

        Samples count by their size to the power of −2.5, so that the error tends to be a fraction
        of the stress and smallest near rest, where a wave gets its phase.
        """
        P, slope = network.correction(self.shapes, self.moving)
        squares = self.squares(P - self.target)
        if slope is not None:
            squares = squares + self.slope_weight * self.squares(slope - self.slope)
        return (self.share * squares).mean()

    def stress_loss(self, network: StressNetwork) -> torch.Tensor:
        """Compute the mean square error of stress alone, each sample counted once."""
        P, _ = network.correction(self.shapes)
        return self.squares(P - self.target).mean()

    def squares(self, error: torch.Tensor) -> torch.Tensor:
        """Compute weighted squares (n, 4) of the errors of S, from errors of P̂ (n, 4)."""
        cauchy = torch.matmul(self.to_cauchy, error[:, :, None])[:, :, 0]
        return cauchy**2 * self.weight


def fit_baseline(network: StressNetwork, data: Data, settings: TrainingSettings) -> None:
    """Set the coefficients of the network's baseline, by linear least squares.

    Errors of each component count relative to its spread. Where the slopes at rest are known, the
    linear monomials are fixed by them, and the others are fitted to the rest.
    """
    size = len(network.coefficients)
    if size:
        gram, right = _normal_equations(network, data, settings)
    else:  # degree 0
        gram = np.zeros((0, 0))
        right = np.zeros(0)
    network.second_order = data.rest is not None
    if data.rest is None:
        coefficients = np.full(size, np.nan)
    else:
        coefficients = network.rest_coefficients(data.rest)
    # constrained least squares: what is fixed moves to the right-hand side
    free = np.isnan(coefficients)
    right -= gram[:, ~free] @ coefficients[~free]
    # monomials of degree 5 are small; a unit diagonal keeps them above the threshold of `lstsq`
    scale = np.sqrt(np.maximum(np.diag(gram)[free], np.finfo(float).tiny))
    A = gram[np.ix_(free, free)] / scale[:, None] / scale
    solution, *_ = np.linalg.lstsq(A, right[free] / scale, rcond=_LEAST_EIGENVALUE)
    coefficients[free] = solution / scale
    network.coefficients.copy_(torch.from_numpy(coefficients))


def _normal_equations(
    network: StressNetwork, data: Data, settings: TrainingSettings
) -> tuple[Array, Array]:
    """Return matrix (m, m) and right-hand side (m,) for the coefficients of all components."""
    size = len(network.coefficients)
    owner = network.owner.numpy()
    weight = 1.0 / _spread(data.target).numpy() ** 2
    gram = np.zeros((size, size))
    right = np.zeros(size)
    for start in range(0, len(data.x), _BLOCK):
        block = slice(start, start + _BLOCK)
        x = data.x[block]
        # (monomials or their slopes (n, m), what they are to give (n, 4))
        equations = [(network.monomials(x), data.target[block])]
        if data.slopes is not None:
            root = settings.tangent_weight**0.5
            for k, unit in enumerate(torch.eye(INPUTS, dtype=x.dtype)):
                _, monomial_slopes = along(network.monomials, (x,), (unit.expand_as(x),))
                equations.append((root * monomial_slopes, root * data.slopes[block, :, k]))
        for matrix, values in equations:
            for k in range(COMPONENTS):
                members = np.flatnonzero(owner[:, k])
                A = matrix[:, members].numpy()
                gram[np.ix_(members, members)] += weight[k] * (A.T @ A)
                right[members] += weight[k] * (A.T @ values[:, k].numpy())
    return gram, right


def _spread(target: torch.Tensor) -> torch.Tensor:
    """Compute the standard deviation (4,) of each component (n, 4), at least `_LEAST_SPREAD`."""
    spread = target.std(dim=0)
    least = max(_LEAST_SPREAD * float(spread.max()), np.finfo(float).tiny)
    return spread.clamp(min=least)


def make_task(network: StressNetwork, data: Data, settings: TrainingSettings) -> Task:
    """Make the task of learning what the polynomial of the network leaves of the data."""
    to_cauchy = network.to_cauchy(data.x)
    size_of_sample = data.x.square().mean(dim=1, keepdim=True).sqrt()
    share = (size_of_sample + _SMALL) ** -2.5
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
    _, baseline_slope = along(network.baseline, (data.x,), (direction,))
    slope = torch.einsum("nkj,nj->nk", data.slopes, direction) - baseline_slope
    # Where a pair of particles is about to cross the cut-off, the tangent of the slow manifold is
    # exact for steps of F of some 1e-5 and off for all others; a few such steer a whole network.
    size = task.squares(slope).sum(dim=1, keepdim=True).sqrt()
    is_usual = (size <= _OUTLIER * size.median()).to(slope.dtype)
    _, moving = along(network.shapes, (data.x,), (direction,))
    slope_weight = settings.tangent_weight * is_usual
    return replace(task, moving=moving, slope=slope, slope_weight=slope_weight)
