"""The large bar by full FE² over the first quarter of a period: most of an hour on two cores."""

from benchmarks.large import quarter as run

__all__ = ["run"]
