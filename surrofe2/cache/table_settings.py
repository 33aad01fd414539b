"""How a table of RVE answers is kept."""

from __future__ import annotations

from dataclasses import dataclass

from surrofe2.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class TableSettings:
    """Recipe section [table].

    Attributes:
        enabled: whether a table answers what the network may not, with `--law cached`.
        tolerance: largest error of a stress, as a share of the spread of stress.
        most_records: after so many a table grows its ellipsoids, but takes no new record.
    """

    enabled: bool = False
    tolerance: float = 1e-3
    most_records: int = 100_000

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance < 1.0:
            raise InputError(
                f"table.tolerance: {self.tolerance}; it must be between 0 and 1, a share of the "
                "spread of stress"
            )
        if self.most_records < 1:
            raise InputError(f"table.most_records: {self.most_records}; it must be at least 1")
