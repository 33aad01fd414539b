"""Records of runs that nobody has made."""

from surrofe2.store.run_folder import RunRecord


def finished_record(recipe, law, wall_time, counts):
    """The record of a finished run by constrained runs."""
    return RunRecord(
        status="finished",
        recipe=recipe.to_dict(),
        law=law,
        initialisation="constrained-runs",
        solver="direct",
        package_version="0.1.0",
        created="2026-01-01T00:00:00+00:00",
        cell_fingerprint=recipe.study().cell.parameters.fingerprint,
        threads=2,
        wall_time=wall_time,
        counts=counts,
    )
