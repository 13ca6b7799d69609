"""Reads what the runs of a series say together, to be exported beside them."""

from collections.abc import Sequence
from pathlib import Path
from typing import cast

from acquisition.record.digest import sha256_of
from rig.analysis import JsonObject, RunResults, Series, SessionResults, encoded, results_path, units_of
from rig.export.run import ExportedResults, ExportedRun

SERIES_NAME = "series"


def exported_series(
    source: Path, series: Series, runs: Sequence[tuple[ExportedRun, RunResults]]
) -> ExportedResults:
    """The series of a results file, with the hashes of that file and of the records that are combined in it,
    in the order of its lists of runs.
    """
    runs = series.combined(runs)
    path = results_path(source)
    about = {"results": path.name, "sha256": sha256_of(path)}
    samples = {run.provenance.get("session.sample", "") for run, _ in runs}
    if len(samples) == 1 and (sample := samples.pop()):
        about["session.sample"] = sample
    about |= {f"runs.{place}": f"{one.record}, SHA-256 {one.sha256}" for place, (_, one) in enumerate(runs)}
    simulated = sum(bool(one.simulated) for _, one in runs)
    if simulated:
        about["simulated"] = f"SIMULATED: {simulated} of {len(runs)} runs"
    alone = SessionResults(runs=(), series=series)
    tree = encoded(alone)
    units = {name.removeprefix("series."): unit for name, unit in units_of(alone, tree).items()}
    notes = tuple(f"{run.name}: {note}" for run, _ in runs for note in run.notes)
    return ExportedResults(SERIES_NAME, cast(JsonObject, tree["series"]), units, about, notes)
