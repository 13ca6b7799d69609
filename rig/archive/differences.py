"""`rig archive diff`: which parameters moved from one version of the results to the next, and why."""

from collections.abc import Sequence
from math import isnan
from pathlib import Path
from typing import NamedTuple

from processing.errors import ConfigurationError
from rig.analysis import RunResults, recorded_results
from rig.archive.blind import sealed
from rig.archive.chosen import chosen_runs
from rig.archive.refits import Recipe, Refit, read_refit
from rig.archive.store import Archive, reads_archive
from rig.presentation import Cell, Table, print_tables, signed, with_uncertainty
from rig.replay import parameter_changes

_CALIBRATIONS = ("lever", "axes", "shutter", "sensor", "timebase", "calibration")
"""Sections of the configuration that say what a calibration found."""


class _Version(NamedTuple):
    name: str
    recipe: Recipe | None
    results: RunResults


@reads_archive
def print_differences(archive: Path, names: Sequence[str], where: str, least_u: float) -> None:
    """Print each parameter that moved by more than `least_u` standard uncertainties, with what may be why.

    Compared are the newest results that `refit` made of a run and those before them; where it made results
    once only, those beside the record. Raises ConfigurationError where there is nothing to compare.
    """
    store = Archive(archive).refits
    by_run: dict[str, list[str]] = {}
    for name in store.names():
        by_run.setdefault(name.partition("-")[0], []).append(name)
    hidden, compared = sealed(archive) is not None, 0
    rows: list[list[Cell]] = []
    shown = []
    for sha256, record in chosen_runs(archive, names, where or ("" if names else "true")).items():
        refits = [read_refit(store.path(name)) for name in by_run.get(sha256[:16], [])]
        before, after = _last_two(refits, record, sha256)
        if before is None or after is None:
            continue
        compared += 1
        for change in parameter_changes(before.results, after.results):
            if not (abs(change.in_u) > least_u or isnan(change.in_u)):
                continue
            why = "; ".join(reasons(before, after))
            values = (
                ["hidden"] * 2
                if hidden
                else [with_uncertainty(*v) for v in (change.recorded, change.replayed)]
            )
            shown.append([sha256[:8], change.name.removeprefix("fits."), *values, signed(change.in_u), why])
            rows.append([sha256, change.name, change.in_u, why])
    if not compared:
        raise ConfigurationError(
            "no run that is meant has two versions of results; rig archive refit makes them"
        )
    columns, head = (
        ("sha256", "parameter", "in_u", "why"),
        ("run", "parameter", "before", "after", "u", "why"),
    )
    note = f"{compared} runs compared; moved by more than {least_u:g} u: {len(rows)} parameters."
    print_tables([Table("differences", "What moved", columns, rows, head, shown, note)])


def _last_two(refits: Sequence[Refit], record: Path, sha256: str) -> tuple[_Version | None, _Version | None]:
    made = [
        _Version(item.name, item.recipe, item.results)
        for item in sorted(refits, key=lambda item: item.order)
        if item.results is not None
    ]
    if len(made) == 1 and record.parent.is_dir():
        name, found = recorded_results(record, sha256)
        if found is not None:
            made.insert(0, _Version(name, None, found))
    return (made[-2], made[-1]) if len(made) > 1 else (None, None)


def reasons(before: _Version, after: _Version) -> list[str]:
    """What differs between two versions: code, configuration, calibration."""
    found = []
    if before.recipe is None or after.recipe is None:
        found.append(f"code ({before.name} does not state its own)")
    elif before.recipe.code != after.recipe.code:
        found.append(f"code ({before.recipe.code} → {after.recipe.code})")
    level_before = "as fitted" if before.recipe is None else before.recipe.level
    if after.recipe is not None and level_before not in (after.recipe.level, "as fitted"):
        found.append(f"configuration (from {level_before} → {after.recipe.level})")
    settings = [set(() if version.recipe is None else version.recipe.settings) for version in (before, after)]
    changed = sorted(settings[0] ^ settings[1])
    calibrated = [text for text in changed if text.split(".")[0].split("=")[0] in _CALIBRATIONS]
    configured = [text for text in changed if text not in calibrated]
    keys = {*before.results.settings, *after.results.settings}
    configured += sorted(
        f"fit.{key}"
        for key in keys
        if before.results.settings.get(key) != after.results.settings.get(key)
        and not any(text.startswith(f"fit.{key}=") for text in configured)
    )
    inputs = [version.results.inputs_sha256 for version in (before, after)]
    for name in sorted({*inputs[0], *inputs[1]}):
        if inputs[0].get(name) != inputs[1].get(name):
            (calibrated if name.startswith("calibration/") else configured).append(name)
    found += [f"configuration ({', '.join(configured)})"] if configured else []
    found += [f"calibration ({', '.join(calibrated)})"] if calibrated else []
    return found or ["nothing that is known differs"]
