"""How a surrogate is trained."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from surrofe2.errors import InputError
from surrofe2.surrogate.features import FORMS

PRECISIONS = ("float64", "float32")
_INTEGERS = {
    "baseline_degree": (0, 5),
    "members": (1, 16),
    "iterations": (0, 1_000_000),
    "history": (1, 10_000),
    "checkpoint_interval": (1, 1_000_000),
    "seed": (0, 2**63 - 1),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingSettings:
    """Shape of the surrogate and effort of its training.

    Attributes:
        hidden: number of tanh units in each hidden layer of the rate-dependent part.
        energy_hidden: the same of the energy.
        form: "stress": one network for all of it, the most accurate for its cost; "energy":
            elastic stress from an energy, and a part that vanishes with Ḟ; "potentials": as
            "energy", the viscous stress linear in Ḟ and from a dissipation potential too
            (elastic and slow manifold only).
        members: networks of the ensemble, whose mean is the answer; 1: no ensemble.
        tangent_weight: of the squared error of tangents in the loss, where the samples have
            them; 0: stress alone.
        baseline_degree: degree of the fitted polynomial that the network corrects; 1: a linear
            Kelvin–Voigt law; 0: none.
        precision: of the stored weights and of inference; training is always in float64.
        held_out: share of the samples kept from training, on which the errors are measured.
        iterations: of the full-batch quasi-Newton method (L-BFGS).
        history: pairs of steps and gradients that L-BFGS keeps.
        checkpoint_interval: iterations between two checkpoints.
        seed: of the initial weights and of the choice of held-out samples.
    """

    hidden: tuple[int, ...] = (24, 24)
    energy_hidden: tuple[int, ...] = (16, 16)
    form: str = "stress"
    members: int = 1
    tangent_weight: float = 0.1
    baseline_degree: int = 3
    precision: str = "float64"
    held_out: float = 0.1
    iterations: int = 1000
    history: int = 100
    checkpoint_interval: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("hidden", "energy_hidden"):
            object.__setattr__(self, name, _sizes(name, getattr(self, name)))
        if self.form not in FORMS:
            raise InputError(f"training.form: {self.form!r}; it must be one of {', '.join(FORMS)}")
        weight = self.tangent_weight
        number = isinstance(weight, int | float) and not isinstance(weight, bool)
        if not number or not 0.0 <= weight < float("inf"):
            raise InputError(
                f"training.tangent_weight: {weight!r}; it must be a number of at least 0"
            )
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


def _sizes(name: str, value: Any) -> tuple[int, ...]:
    allowed = isinstance(value, tuple | list) and len(value) >= 1
    if not allowed or not all(type(size) is int and 1 <= size <= 1024 for size in value):
        raise InputError(
            f"training.{name}: {value!r}; it must be a list of layer sizes from 1 to 1024"
        )
    return tuple(value)
