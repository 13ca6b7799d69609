"""Fits of tables and films by `rig fit`: analysed, printed and written one after another."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from processing.errors import ConfigurationError, DataError, DeviceError, MissingPackage
from rig.analysis import (
    RESULTS_NAME,
    AnalysedTable,
    SessionResults,
    analyse_trajectory,
    chosen_laws,
    encoded,
    print_series,
    print_table,
    relative_record,
    series_of_runs,
    write_results,
)
from rig.instrument import fill_from_files
from rig.intake import SeismometerRecord, Trajectory
from rig.report import make_table_report
from rig.settings import FITTED, load_configuration, refuse_without_effect
from rig.terminal import answer, print_line

_OF_TABLES = {
    **FITTED,
    "session": (*FITTED["session"], "contact_history", "notes", "operator", "sample", "initial_", "final_"),
}
"""Beginnings of the keys that change the results of a table, by section."""


class TableOptions(NamedTuple):
    """Options of a fit of tables: configuration with overrides, laws to compare, auxiliary seismometer."""

    config_path: Path | None = None
    overrides: Sequence[str] = ()
    laws: Sequence[str] = ()
    seismometer: SeismometerRecord | None = None


def fit_several(
    inputs: Sequence[tuple[str, Path, Callable[[], Trajectory]]], output: Path | None, wanted: TableOptions
) -> int:
    """Analyse runs, each given by its name, file and a function that reads it; several have a folder each.

    A run of several that cannot be analysed does not stop the others; 1 is returned if there was such a run.
    """
    if len(inputs) == 1:
        ((_, path, read),) = inputs
        _fit(path, read(), output, wanted, alone=True)
        return 0
    folders = [None if output is None else output / _folder_name(name) for name, _, _ in inputs]
    for folder in (output, *folders):
        if folder is not None and (folder / RESULTS_NAME).exists():
            raise ConfigurationError(
                f"{folder / RESULTS_NAME}: exists already and is not overwritten; choose another folder"
            )
    failed, tables = 0, dict[str, AnalysedTable]()
    for (name, path, read), folder in zip(inputs, folders, strict=True):
        print_line(f"--- run {name}")
        try:
            tables[name] = _fit(path, read(), folder, wanted)
        except MissingPackage:
            # no other run can be read either
            raise
        except (DataError, DeviceError) as error:
            failed += 1
            answer(not_analysed=[{"run": name, "reason": str(error)}])
            print_line(f"not analysed: {error}")
    together = series_of_runs(inputs[0][1], tables)
    if together is not None:
        print_line(f"--- runs {', '.join(tables)}")
        print_series(together.series)
        answer(series=lambda: encoded(together)["series"])
        if output is not None:
            _save(output, together)
    return int(failed > 0)


def _folder_name(name: str) -> str:
    """Name of the folder of a run: its name without characters that a folder's should not have."""
    plain = re.sub(r"[^\w.-]+", "-", name).strip("-.")
    return f"run-{plain}" if plain.isdigit() or not plain else plain


def _fit(
    path: Path, trajectory: Trajectory, output: Path | None, wanted: TableOptions, *, alone: bool = False
) -> AnalysedTable:
    """Analyse one run, print and write it; with the series of its decays if it is `alone`."""
    laws = wanted.laws
    compared = chosen_laws(laws) if laws else ()
    if wanted.config_path:
        stated = load_configuration(wanted.config_path, wanted.overrides, needs_camera=False)
        refuse_without_effect(wanted.overrides, _OF_TABLES, "a table holds neither frames nor spots")
        table = analyse_trajectory(path, trajectory, fill_from_files(stated), compared, wanted.seismometer)
    else:
        table = analyse_trajectory(path, trajectory, None)
    if laws and table.longest.problem:
        raise ConfigurationError(f"--law {laws[0]}: {table.longest.problem}")
    if not alone:
        # the series of several runs is another result
        table = replace(table, series=None)
    print_table(path, table)
    _write(path, output, table)
    if output is not None:
        for name, made in make_table_report(table, output):
            answer(written=[made])
            print(f"{name:<12} {made}")
    return table


def _write(path: Path, output: Path | None, results: SessionResults) -> None:
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        record = relative_record(path, output)
        _save(output, replace(results, runs=tuple(replace(run, record=record) for run in results.runs)))
    answer(results=lambda: [encoded(results)])


def _save(folder: Path, results: SessionResults) -> None:
    path = folder / RESULTS_NAME
    write_results(path, results)
    answer(written=[path])
    print(f"results      {path}")
