"""`rig fit` of a film, or of a folder of images or of films."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from processing.errors import ConfigurationError

if TYPE_CHECKING:
    from rig.analysis import AnalysedTable
    from rig.intake import FilmAsked


def fit_film(
    film: Path,
    asked: "FilmAsked",
    output: Path | None,
    config: Path | None,
    run: str,
    overrides: Sequence[str],
    laws: Sequence[str],
) -> int:
    """Follow the object in each film and fit its motion; returns the exit status.

    `run` is the one of a folder of films, by name or number; empty: all.
    """
    from rig.analysis import TableFit, fit_several
    from rig.intake import film_trajectory, films_in
    from rig.presentation import TimeLeft, print_line

    if overrides and config is None:
        raise ConfigurationError(f"--set {overrides[0]}: has no effect without --config")
    if laws and config is None:
        raise ConfigurationError(f"--law {laws[0]}: laws need --config CONFIG with [pendulum], and an angle")
    if asked.force and asked.rate_hz is None:
        raise ConfigurationError("--force-rate: needs --rate, the rate to enforce")
    films = _chosen_films(film, films_in(film), run)
    if len(films) > 1:
        print_line(f"{film}: {len(films)} films: {', '.join(each.name for each in films)}")
    inputs = [
        (one.stem, one, partial(film_trajectory, one, asked, TimeLeft(f"{one}: frames"))) for one in films
    ]
    return fit_several(inputs, output, TableFit(config, overrides, table_report, laws))


def _chosen_films(film: Path, inside: Sequence[Path], run: str) -> list[Path]:
    """The film itself, or those of a folder, of which `run` names one."""
    if len(inside) < 2 and run:
        raise ConfigurationError(f"--run {run}: {film} holds one film; leave the option out")
    by_number = [inside[int(run) - 1]] if run.isdecimal() and 0 < int(run) <= len(inside) else []
    chosen = [each for each in inside if run in ("", each.name, each.stem)] or by_number
    if inside and not chosen:
        names = ", ".join(each.name for each in inside)
        raise ConfigurationError(f"--run {run}: {film} holds no such film; there are {names}")
    return chosen or [film]


def table_report(table: "AnalysedTable", folder: Path) -> Sequence[tuple[str, Path]]:
    """Draw what was found in a table or a film; imported where it is needed, as figures take a second."""
    from rig.report import make_table_report

    return make_table_report(table, folder)
