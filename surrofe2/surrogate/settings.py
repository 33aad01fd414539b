"""How a surrogate is trained, and how the bound of its error is calibrated."""

from __future__ import annotations

from dataclasses import dataclass

from surrofe2.errors import InputError
from surrofe2.settings import check_settings, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """Shape of the surrogate and effort of its training, by full-batch L-BFGS.

    The network corrects a polynomial; of degree 1 that is a linear Kelvin–Voigt law.
    """

    hidden: tuple[int, ...] = setting(
        (24, 24), "tanh units in each hidden layer", least=1, most=1024
    )
    tangent_weight: float = setting(
        0.1, "of the squared error of tangents in the loss, where samples have them", least=0.0
    )
    baseline_degree: int = setting(3, "of the polynomial; 0: none", least=0, most=5)
    held_out: float = setting(
        0.1, "share of the samples on which errors are measured", above=0.0, below=1.0
    )
    iterations: int = setting(1000, "of L-BFGS, at most", least=0, most=1_000_000)
    bound: float = setting(
        0.0,
        "of the error, as a share of the spread of stress, that ends training; 0: none does",
        least=0.0,
    )
    history: int = setting(100, "pairs of steps and gradients it keeps", least=1, most=10_000)
    checkpoint_interval: int = setting(
        100, "iterations between two checkpoints", least=1, most=1_000_000
    )
    seed: int = setting(0, "of initial weights and held-out samples", least=0, most=2**63 - 1)

    def __post_init__(self) -> None:
        check_settings(self, "training")
        if not self.hidden:
            raise InputError("training.hidden: []; it must be a list of at least one size")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSettings:
    """Number and kind of the paths along which the true stress is asked.

    A third as many again of each kind shape the local scale, which the others then calibrate.
    Each kind that is used needs at least 1/share − 1 paths.
    """

    walks: int = setting(500, "random walks in the sampling range", least=0)
    states: int = setting(
        2000, "single random states of it, as many of its corners, as many near rest", least=0
    )
    runs: int = setting(
        100, "runs of the recipe's problem under varied loads; all points are one path", least=0
    )
    length: int = setting(24, "states taken along a walk; along a run a third as many", least=1)
    share: float = setting(
        0.01, "of new paths on which the bound may break, the nominal share", above=0.0, below=1.0
    )
    seed: int = setting(2, "of the paths", least=0)

    def __post_init__(self) -> None:
        check_settings(self, "calibration")
        needed = 1.0 / self.share - 1.0
        for name, count in (("walks", self.walks), ("states", self.states), ("runs", self.runs)):
            if 0 < count < needed * (1.0 - 1e-9):
                raise InputError(
                    f"calibration.{name}: {count}; it must be 0 or at least {needed:.4g}, "
                    f"1/share − 1, for a share of {self.share:g}"
                )
