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

_TABLE_KEYS = {
    **FITTED,
    "session": (*FITTED["session"], "contact_history", "notes", "operator", "sample", "initial_", "final_"),
}
"""Beginnings of the keys that change the results of a table, by section."""


class TableOptions(NamedTuple):
    """Options of a fit of tables."""

    config_path: Path | None = None
    overrides: Sequence[str] = ()
    laws: Sequence[str] = ()
    """Names of the laws to compare with the paper's."""
    seismometer: SeismometerRecord | None = None


def fit_several(
    inputs: Sequence[tuple[str, Path, Callable[[], Trajectory]]], output: Path | None, options: TableOptions
) -> int:
    """Analyse runs, each given by its name, its file and a function that reads it.

    Of several runs each has its own folder, and one that cannot be analysed does not stop the others; the
    exit status is then 1.
    """
    if len(inputs) == 1:
        ((_, path, read),) = inputs
        _fit(path, read(), output, options, is_only=True)
        return 0
    folders = [None if output is None else output / _folder_name(name) for name, _, _ in inputs]
    for folder in (output, *folders):
        if folder is not None and (folder / RESULTS_NAME).exists():
            raise ConfigurationError(
                f"{folder / RESULTS_NAME}: exists already and is not overwritten; choose another folder"
            )
    has_failed, tables = False, dict[str, AnalysedTable]()
    for (name, path, read), folder in zip(inputs, folders, strict=True):
        print_line(f"--- run {name}")
        try:
            tables[name] = _fit(path, read(), folder, options)
        except MissingPackage:
            # no other run can be read either
            raise
        except (DataError, DeviceError) as error:
            has_failed = True
            answer(not_analysed=[{"run": name, "reason": str(error)}])
            print_line(f"not analysed: {error}")
    combined = series_of_runs(inputs[0][1], tables)
    if combined is not None:
        print_line(f"--- runs {', '.join(tables)}")
        print_series(combined.series)
        answer(series=lambda: encoded(combined)["series"])
        if output is not None:
            _save(output, combined)
    return int(has_failed)


def _folder_name(name: str) -> str:
    """Name of the folder of a run: the run's name without characters that paths should not have."""
    plain = re.sub(r"[^\w.-]+", "-", name).strip("-.")
    return f"run-{plain}" if plain.isdigit() or not plain else plain


def _fit(
    path: Path, trajectory: Trajectory, output: Path | None, options: TableOptions, *, is_only: bool = False
) -> AnalysedTable:
    """Analyse one run, print and write it; the only run with the series of its decays."""
    laws = options.laws
    compared = chosen_laws(laws) if laws else ()
    if options.config_path:
        config = load_configuration(options.config_path, options.overrides, needs_camera=False)
        refuse_without_effect(options.overrides, _TABLE_KEYS, "a table holds neither frames nor spots")
        table = analyse_trajectory(path, trajectory, fill_from_files(config), compared, options.seismometer)
    else:
        table = analyse_trajectory(path, trajectory, None)
    if laws and table.longest.problem:
        raise ConfigurationError(f"--law {laws[0]}: {table.longest.problem}")
    if not is_only:
        # the series of several runs is another result
        table = replace(table, series=None)
    print_table(path, table)
    _write(path, output, table)
    if output is not None:
        for name, file in make_table_report(table, output):
            answer(written=[file])
            print(f"{name:<12} {file}")
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
