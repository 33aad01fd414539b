"""How a table of RVE answers is kept."""

from __future__ import annotations

from dataclasses import dataclass

from surrofe2.settings import check_settings, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class TableSettings:
    """Recipe section [table]."""

    enabled: bool = setting(
        False, "whether a table answers what the network may not, with --law cached"
    )
    tolerance: float = setting(
        1e-3, "largest error of a stress, a share of the spread of stress", above=0.0, below=1.0
    )
    most_records: int = setting(
        100_000, "after so many a table grows its ellipsoids, but takes no new record", least=1
    )

    def __post_init__(self) -> None:
        check_settings(self, "table")
