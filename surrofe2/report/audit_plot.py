"""The errors that audits of cached runs found, as a histogram."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from surrofe2.io.run_folder import StoredRun

_BINS_A_DECADE = 10


def has_audit(run: StoredRun) -> bool:
    """Whether any answer of the run was audited and solved."""
    cache = run.record.cache
    return cache is not None and bool(cache["audit"]["quantiles"])


def draw_audits(axes: Axes, runs: Sequence[StoredRun], colours: Sequence[str]) -> None:
    """Share of the audited answers over their error, the tolerance and the 99 % quantile marked."""
    for run, colour in zip(runs, colours, strict=True):
        assert run.record.cache is not None
        audit = run.record.cache["audit"]
        edges, shares = _coarse(audit["histogram"])
        axes.stairs(100.0 * shares, edges, color=colour, fill=True, alpha=0.25)
        axes.stairs(100.0 * shares, edges, color=colour, linewidth=1.0)
        axes.axvline(audit["quantiles"]["0.99"], color=colour, linewidth=1.0, linestyle=":")
        tolerance = float(audit["tolerance"])
        if np.isfinite(tolerance):
            axes.axvline(tolerance, color=colour, linewidth=1.4, linestyle="--")
            axes.annotate(
                f"tolerance: {audit['violations']} of {audit['audited']:,} above",
                (tolerance, 0.95),
                xycoords=("data", "axes fraction"),
                xytext=(-4, 0),
                textcoords="offset points",
                ha="right",
                va="top",
                rotation=90,
                fontsize=7,
                color=colour,
            )
    axes.set_xscale("log")
    axes.set_xlabel("error of the cache's stress found by audits (µN/µm); dotted: 99 % are below")
    axes.set_ylabel("audited\nanswers (%)")
    axes.grid(alpha=0.25)


def _coarse(histogram: dict) -> tuple[np.ndarray, np.ndarray]:
    """(b + 1,) edges and (b,) shares of a stored histogram in ten bins a decade."""
    fine, counts = np.array(histogram["bins"]), np.array(histogram["counts"], dtype=np.float64)
    many = histogram["bins_a_decade"] // _BINS_A_DECADE
    # Fine bin k ends at the smallest edge times 10^(k / bins a decade).
    coarse = -(-fine // many)
    first, last = coarse.min(), coarse.max()
    shares = np.bincount(coarse - first, weights=counts) / counts.sum()
    powers = np.arange(first - 1, last + 1) / _BINS_A_DECADE
    return histogram["smallest_edge"] * 10.0**powers, shares
