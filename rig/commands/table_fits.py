"""Fits of tables, films and envelopes by `rig fit`: analysed, printed and written one after another."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from processing.errors import ConfigurationError, DataError, DeviceError, MissingPackage
from rig.analysis import (
    RESULTS_NAME,
    AnalysedTable,
    EnvelopeResults,
    SessionResults,
    analyse_envelope,
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
from rig.intake import SeismometerRecord, TableColumns, Trajectory
from rig.report import make_table_report
from rig.settings import KeyUseMonitor, load_configuration
from rig.terminal import answer, print_line, with_uncertainty

ENVELOPES = ("amplitude", "power")


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
        key_monitor = KeyUseMonitor(stated, wanted.overrides, "a table holds neither frames nor spots")
        table = analyse_trajectory(
            path, trajectory, fill_from_files(key_monitor.config), compared, wanted.seismometer
        )
        if not table.longest.problem:
            key_monitor.refuse_unread()
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


def fit_envelope_table(
    path: Path, output: Path | None, columns: TableColumns, kind: str, frequency_hz: float | None
) -> int:
    """Analyse an envelope, print its time constant, write results.json. Returns the exit status."""
    if kind not in ENVELOPES:
        raise ConfigurationError(f"--envelope {kind!r}: take one of {', '.join(ENVELOPES)} (in dB)")
    found, results = analyse_envelope(path, columns, decibel=kind == "power", frequency_hz=frequency_hz)
    unit = f" {results.unit}"
    print_line(f"{path}: an envelope of {found.samples} values, noise of one {found.noise:.3g}{unit}")
    for line in results.understood:
        print_line(f"  {line}")
    floor = (
        f"noise floor {found.floor:.3g}{unit}" if math.isfinite(found.floor) else "no noise floor is reached"
    )
    print_line(f"  {found.initial:.4g}{unit} at the start, {floor}")
    of_power = with_uncertainty(0.5 * found.tau_s, 0.5 * found.u_tau_s)
    print_line(f"  time constant of the amplitude {with_uncertainty(found.tau_s, found.u_tau_s)} s")
    print_line(f"  time constant of the power {of_power} s")
    if results.damping is not None:
        of_parts = "sqrt(power)" if kind == "power" else results.unit
        for line in results.damping.lines(of_parts, results.unit):
            print_line(f"  {line}")
    if results.quality_factor is not None:
        print_line(f"  quality factor {with_uncertainty(*results.quality_factor)}")
    for warning in results.warnings:
        print_line(f"  note: {warning}")
    _write(path, output, results)
    return 0


def _write(path: Path, output: Path | None, results: SessionResults | EnvelopeResults) -> None:
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        if isinstance(results, SessionResults):
            record = relative_record(path, output)
            results = replace(results, runs=tuple(replace(run, record=record) for run in results.runs))
        _save(output, results)
    answer(results=lambda: [encoded(results)])


def _save(folder: Path, results: SessionResults | EnvelopeResults) -> None:
    path = folder / RESULTS_NAME
    write_results(path, results)
    answer(written=[path])
    print(f"results      {path}")
