"""How a surrogate is trained."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from surrofe2.errors import InputError

PRECISIONS = ("float64", "float32")
_INTEGERS = {
    "baseline_degree": (0, 5),
    "iterations": (0, 1_000_000),
    "history": (1, 10_000),
    "checkpoint_interval": (1, 1_000_000),
    "seed": (0, 2**63 - 1),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """Shape of the surrogate and effort of its training.

    Attributes:
        hidden: number of tanh units in each hidden layer.
        baseline_degree: degree of the fitted polynomial that the network corrects; 0: none.
        precision: of the stored weights and of inference; training is always in float64.
        held_out: share of the samples kept from training, on which the errors are measured.
        iterations: of the full-batch quasi-Newton method (L-BFGS).
        history: pairs of steps and gradients that L-BFGS keeps.
        checkpoint_interval: iterations between two checkpoints.
        seed: of the initial weights and of the choice of held-out samples.
    """

    hidden: tuple[int, ...] = (32, 32)
    baseline_degree: int = 4
    precision: str = "float64"
    held_out: float = 0.1
    iterations: int = 500
    history: int = 100
    checkpoint_interval: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "hidden", _sizes(self.hidden))
        if self.precision not in PRECISIONS:
            raise InputError(
                f"training.precision: {self.precision!r}; it must be one of {', '.join(PRECISIONS)}"
            )
        if not isinstance(self.held_out, float) or not 0.0 < self.held_out < 1.0:
            raise InputError(f"training.held_out: {self.held_out!r}; it must be between 0 and 1")
        for name, (least, most) in _INTEGERS.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
                raise InputError(
                    f"training.{name}: {value!r}; it must be an integer from {least} to {most}"
                )

    def to_dict(self) -> dict[str, Any]:
        """All fields by name, for files."""
        return asdict(self)


def _sizes(value: Any) -> tuple[int, ...]:
    allowed = isinstance(value, tuple | list) and len(value) >= 1
    if not allowed or not all(type(size) is int and 1 <= size <= 1024 for size in value):
        raise InputError(
            f"training.hidden: {value!r}; it must be a list of layer sizes from 1 to 1024"
        )
    return tuple(value)
