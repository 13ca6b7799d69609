"""`rig video`."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from processing.errors import ConfigurationError
from rig.commands.arguments import Set
from rig.commands.inputs import there
from rig.commands.json_answers import in_json
from rig.commands.outputs import folder_without, output_option

if TYPE_CHECKING:
    from rig.analysis import AnalysedTable


def register(app: typer.Typer) -> None:
    """Add `rig video`."""
    app.command()(in_json(video))


def video(
    film: Annotated[
        Path,
        typer.Argument(
            help="A film, raw pixels, or a folder of images or of films.", show_default=False, callback=there
        ),
    ],
    output: Annotated[
        Path | None,
        output_option(
            "Folder for results.json, report.html and positions.csv.",
            folder_without("results.json", "report.html", "positions.csv"),
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            help="Configuration with [pendulum] and [fit]; the pixel is an angle then.", callback=there
        ),
    ] = None,
    pixel: Annotated[
        str,
        typer.Option(
            help="Size of a pixel with its unit, or a length over its pixels: '0.142 mm', '3.2 arcsec', "
            "'85 mm over 600 px'; default: px."
        ),
    ] = "",
    rate: Annotated[
        float | None, typer.Option(min=0.001, help="Frames per second, for images or a film without times.")
    ] = None,
    force_rate: Annotated[
        bool, typer.Option("--force-rate", help="Use --rate even if the film's own times contradict it.")
    ] = False,
    dark: Annotated[
        bool | None,
        typer.Option(
            "--dark/--bright", help="The swinging object is darker, or brighter, than its background."
        ),
    ] = None,
    begin: Annotated[float | None, typer.Option("--from", help="Use it from here on, in s.")] = None,
    end: Annotated[float | None, typer.Option("--to", help="Use it up to here, in s.")] = None,
    run: Annotated[
        str,
        typer.Option(help="Folder of several films: the one to use, by name or number; default: all."),
    ] = "",
    law: Annotated[
        list[str] | None,
        typer.Option(help="Compare the paper's law with another one, all or none; may be repeated."),
    ] = None,
    set_: Set = None,
) -> None:
    """From a film to period, damping and a report.

    \b
    Examples:
      rig video swing.mp4 -o runs/swing
      rig video swing.mp4 --pixel '0.142 mm'
    """
    from rig.analysis import fit_several
    from rig.intake import FilmAsked, film_trajectory, films_in
    from rig.presentation import TimeLeft, print_line

    if set_ and config is None:
        raise ConfigurationError(f"--set {set_[0]}: has no effect without --config")
    if law and config is None:
        raise ConfigurationError(f"--law {law[0]}: laws need --config CONFIG with [pendulum], and an angle")
    if force_rate and rate is None:
        raise ConfigurationError("--force-rate: needs --rate, the rate to enforce")
    asked = FilmAsked(rate_hz=rate, force=force_rate, dark=dark, size=pixel, begin_s=begin, end_s=end)
    films = _chosen_films(film, films_in(film), run)
    if len(films) > 1:
        print_line(f"{film}: {len(films)} films: {', '.join(each.name for each in films)}")
    inputs = [
        (one.stem, one, partial(film_trajectory, one, asked, TimeLeft(f"{one}: frames"))) for one in films
    ]
    raise typer.Exit(fit_several(inputs, output, config, set_ or [], table_report, law or []))


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
