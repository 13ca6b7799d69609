"""Results of records in a blind folder: what tells no value stays, all is sealed for the key's owner."""

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from processing.errors import ConfigurationError
from rig.analysis.results import RunResults, SessionResults
from rig.analysis.results_file import decoded, encoded
from rig.sealing import disclosed, enclosed, seal_over

_KEPT = (
    "record",
    "sha256",
    "simulated",
    "inputs_sha256",
    "record_bytes",
    "frames",
    "dropped_frames",
    "losses",
    "beam",
    "settings",
    "calibration",
    "surroundings",
    "clock",
)
"""What is stated of a blind run beside its conditions: what was asked for, and how frames and air were."""
_OF_FIT = "ground"
"""The condition that the fit judges."""


def public_key_over(*paths: Path) -> str:
    """The key that seals what is found of records, or written, below the first blind folder; else empty."""
    for path in paths:
        found = seal_over(path)
        if found is not None and found.is_blind:
            return found.public_key
    return ""


def sealed_results(results: SessionResults, public_key: str) -> SessionResults:
    """The same with nothing open that tells a value of the contact or of the decay."""
    series = None if results.series is None else replace(results, runs=(_without(results.runs[0]),))
    return SessionResults(
        runs=tuple(_sealed(run, public_key) for run in results.runs),
        sealed_series=None if series is None else enclosed(json.dumps(encoded(series)).encode(), public_key),
    )


def disclosed_run(tree: Mapping[str, Any]) -> RunResults:
    """The run that `disclosed` gives as JSON of a run's `sealed`."""
    return decoded(tree["results"], Path("sealed results")).runs[0]


def disclosed_results(results: SessionResults, key: bytes) -> SessionResults:
    """What was sealed. Raises ConfigurationError for another key, RecordError where it has changed."""

    def tree(text: str) -> Any:
        data = disclosed(text, [key])
        if data is None:
            raise ConfigurationError("the results are sealed for another key")
        return json.loads(data)

    runs = tuple(run if run.sealed is None else disclosed_run(tree(run.sealed)) for run in results.runs)
    if results.sealed_series is None:
        return replace(results, runs=runs)
    series = decoded(tree(results.sealed_series), Path("sealed results")).series
    return replace(results, runs=runs, series=series, sealed_series=None)


def _sealed(run: RunResults, public_key: str) -> RunResults:
    data = json.dumps({"results": encoded(SessionResults(runs=(run,)))}).encode()
    found = _without(run)
    # why nothing could be fitted may be said, unless a number is in it
    why = (
        "of the record nothing could be fitted; why is sealed"
        if re.search(r"\d", run.problem)
        else run.problem
    )
    conditions = tuple(
        replace(item, measured="") if item.name == "end" else item
        for item in run.conditions
        if item.name != _OF_FIT
    )
    return replace(found, problem=why, conditions=conditions, sealed=enclosed(data, public_key))


def _without(run: RunResults) -> RunResults:
    return RunResults(**{name: getattr(run, name) for name in _KEPT})
