"""`rig fit`: records, tables and films."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquisition.record import resolve_records
from processing.errors import ConfigurationError
from rig.commands.arguments import (
    ResultsFolder,
    Set,
    fit_input,
    in_json,
    input_argument,
    input_option,
    kind_of,
    refuse_options,
)

if TYPE_CHECKING:
    from rig.intake import SeismometerRecord
    from rig.intake.film import FilmOptions


@in_json
def fit(
    files: Annotated[
        list[Path],
        input_argument(
            "Records (.mcap), their folders; or one table of positions (CSV), one film, one folder of "
            "images or films.",
            fit_input,
        ),
    ],
    output: ResultsFolder = None,
    config: Annotated[
        Path | None, input_option("CSV, film: configuration with [pendulum] and [fit].")
    ] = None,
    time: Annotated[str | None, typer.Option(help="CSV: name or number of the column with the time.")] = None,
    time_unit: Annotated[
        str,
        typer.Option(
            help="CSV: unit of the time: ns (also absolute), us, ms, s, min, h, d; default: from the header "
            "(time_ms, t [ms]), else s.",
            show_default=False,
        ),
    ] = "",
    position: Annotated[
        list[str] | None,
        typer.Option(help="CSV: name or number of the column with the position; twice for two axes."),
    ] = None,
    unit: Annotated[
        str,
        typer.Option(help="CSV: unit of the position: rad, mrad, urad, arcsec, arcmin, deg, or any word."),
    ] = "",
    rate: Annotated[
        float | None,
        typer.Option(min=0.0, help="CSV or film without times: rows or frames per second."),
    ] = None,
    begin: Annotated[
        float | None, typer.Option("--from", help="CSV, film: use it from here on, in s since its start.")
    ] = None,
    end: Annotated[
        float | None, typer.Option("--to", help="CSV, film: use it up to here, in s since its start.")
    ] = None,
    run: Annotated[
        str, typer.Option(help="CSV or folder of several runs: the one to use, by its number; default: all.")
    ] = "",
    law: Annotated[
        list[str] | None,
        typer.Option(help="Compare the paper's law with another one, all or none; may be repeated."),
    ] = None,
    seismometer: Annotated[
        Path | None,
        input_option(
            "Record of a seismometer or tiltmeter beside the run: CSV (time_s and columns in any unit), "
            "miniSEED, SAC."
        ),
    ] = None,
    seismometer_column: Annotated[
        list[str] | None,
        typer.Option(help="Column or channel of the seismometer; may be repeated; default: all of them."),
    ] = None,
    seismometer_offset: Annotated[
        float | None,
        typer.Option(help="Seconds to add to the seismometer's times."),
    ] = None,
    pixel: Annotated[
        str,
        typer.Option(
            help="Film: size of a pixel with its unit, or a length over its pixels: '0.142 mm', "
            "'3.2 arcsec', '85 mm over 600 px'; default: px."
        ),
    ] = "",
    force_rate: Annotated[
        bool, typer.Option("--force-rate", help="Film: use --rate even if its own times contradict it.")
    ] = False,
    dark: Annotated[
        bool | None,
        typer.Option(
            "--dark/--bright", help="Film: the swinging object is darker, or brighter, than its background."
        ),
    ] = None,
    set_: Set = None,
) -> None:
    """Fit records, a table of positions or a film.

    From records come the laws of the contact; from a table or a film the period, the damping and a report,
    and the laws where --config describes the pendulum and positions are angles.

    \b
    Examples:
      rig fit runs/first -o runs/fit
      rig fit decay.csv --unit arcsec --config mine.toml
      rig fit runs/first --seismometer ground.csv
      rig fit swing.mp4 --pixel '0.142 mm' -o runs/swing
    """
    if seismometer is None:
        has_offset = seismometer_offset is not None
        seismometer_options = {"--seismometer-column": seismometer_column, "--seismometer-offset": has_offset}
        refuse_options("without --seismometer", seismometer_options)
    read = partial(_seismometer, seismometer, seismometer_column or (), seismometer_offset)
    table_options = {"--time": time, "--time-unit": time_unit, "--position": position, "--unit": unit}
    film_options = {"--pixel": pixel, "--force-rate": force_rate, "--dark": dark is not None}
    interval = {"--rate": rate is not None, "--from": begin is not None, "--to": end is not None}
    common_options = {"--config": config, **interval, "--run": run}
    kind = "records" if len(files) > 1 else kind_of(files[0])
    if kind == "records":
        refuse_options(
            "on records, only on a table or a film; leave it out", table_options, film_options, common_options
        )
        records = [record for path in files for record in resolve_records(path)]
        targets = [record.resolve() for record in records]
        for record, target in zip(records, targets, strict=True):
            if targets.count(target) > 1:
                raise ConfigurationError(f"{record}: named twice; a run counts once in a series")
        raise typer.Exit(fit_records(records, output, set_ or [], law or [], read()))
    if rate is not None and not rate > 0:
        raise ConfigurationError(f"--rate {rate:g}: the number of rows or frames per second must be above 0")
    if kind == "film":
        from rig.intake.film import FilmOptions

        refuse_options("on a film; leave it out", table_options, {"--seismometer": seismometer})
        options = FilmOptions(rate_hz=rate, force=force_rate, dark=dark, size=pixel, begin_s=begin, end_s=end)
        raise typer.Exit(fit_film(files[0], options, output, config, run, set_ or [], law or []))
    if files[0].suffix.lower() in (".json", ".toml"):
        raise ConfigurationError(
            f"{files[0]}: is not a table; name a record (.mcap), or the table before --config CONFIG"
        )
    from rig.commands.table_fits import TableOptions, fit_several
    from rig.intake import TableColumns

    refuse_options("on a table; leave it out", film_options)
    if law and config is None:
        raise ConfigurationError(f"--law {law[0]}: laws need swings and --config CONFIG with [pendulum]")
    if set_ and config is None:
        raise ConfigurationError(f"--set {set_[0]}: has no effect without --config")
    columns = TableColumns(time, tuple(position or ()), unit, time_unit, rate, begin, end, run)
    if seismometer is not None and config is None:
        raise ConfigurationError("--seismometer: has no effect without --config, which gives the pendulum")
    inputs = [
        (one_run.run, files[0], lambda one_run=one_run: one_run) for one_run in columns.read_runs(files[0])
    ]
    raise typer.Exit(fit_several(inputs, output, TableOptions(config, set_ or [], law or [], read())))


def _seismometer(
    path: Path | None, columns: Sequence[str], offset_s: float | None
) -> "SeismometerRecord | None":
    if path is None:
        return None
    from rig.intake import read_seismometer

    return read_seismometer(path, columns, offset_s)


def fit_records(
    paths: Sequence[Path],
    output: Path | None,
    overrides: Sequence[str],
    laws: Sequence[str] = (),
    seismometer: "SeismometerRecord | None" = None,
) -> int:
    """Fit records; results.json in `output` or beside the first record. Returns the exit status.

    `laws` are names of the registry, to be compared with the default law; `seismometer` recorded the ground.
    """
    from rig.analysis import (
        RESULTS_NAME,
        analyse_record,
        chosen_laws,
        free_path,
        print_results,
        refuse_copies,
        session_results,
        with_laws,
        write_results,
    )
    from rig.terminal import say

    compared = chosen_laws(laws) if laws else ()
    refuse_copies(paths)
    runs = [analyse_record(path, overrides, seismometer=seismometer) for path in paths]
    if compared:
        runs = [with_laws(run, compared) for run in runs]
    folder = output or paths[0].parent
    results = session_results(runs, folder)
    folder.mkdir(parents=True, exist_ok=True)
    target = free_path(folder) if output is None else folder / RESULTS_NAME
    write_results(target, results)
    print_results(results, [("results", target)])
    if target.name != RESULTS_NAME:
        say(
            f"{target.name} is the newest of {folder} now, and report, export, compare and replay take it; "
            f"earlier results stay, to be named ({folder / RESULTS_NAME}); -o FOLDER writes elsewhere"
        )
    return 1 if any(run.problem for run in results.runs) else 0


def fit_film(
    film: Path,
    options: "FilmOptions",
    output: Path | None,
    config: Path | None,
    run: str,
    overrides: Sequence[str],
    laws: Sequence[str],
) -> int:
    """Follow the object in each film and fit its motion; returns the exit status.

    `run` selects a film of a folder by its name or number; if it is empty, all films are fitted.
    """
    from rig.commands.table_fits import TableOptions, fit_several
    from rig.intake.film import film_trajectory, films_in
    from rig.terminal import ProgressLine, print_line

    if overrides and config is None:
        raise ConfigurationError(f"--set {overrides[0]}: has no effect without --config")
    if laws and config is None:
        raise ConfigurationError(f"--law {laws[0]}: laws need --config CONFIG with [pendulum], and an angle")
    if options.force and options.rate_hz is None:
        raise ConfigurationError("--force-rate: needs --rate, the rate to enforce")
    films = _chosen_films(film, films_in(film), run)
    if len(films) > 1:
        print_line(f"{film}: {len(films)} films: {', '.join(path.name for path in films)}")
    inputs = [
        (path.stem, path, partial(film_trajectory, path, options, ProgressLine(f"{path}: frames")))
        for path in films
    ]
    return fit_several(inputs, output, TableOptions(config, overrides, laws))


def _chosen_films(film: Path, films: Sequence[Path], run: str) -> list[Path]:
    """The film itself, or the `films` of a folder, or only the one that `run` names."""
    if len(films) < 2 and run:
        raise ConfigurationError(f"--run {run}: {film} holds one film; leave the option out")
    by_number = [films[int(run) - 1]] if run.isdecimal() and 0 < int(run) <= len(films) else []
    chosen = [path for path in films if run in ("", path.name, path.stem)] or by_number
    if films and not chosen:
        names = ", ".join(path.name for path in films)
        raise ConfigurationError(f"--run {run}: {film} holds no such film; there are {names}")
    return chosen or [film]
