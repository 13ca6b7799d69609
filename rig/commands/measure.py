"""Commands that make, replay and show records."""

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

Config = Annotated[Path, typer.Argument(help="Configuration, a TOML file.", show_default=False)]
Record = Annotated[Path, typer.Argument(help="A record, an MCAP file.", show_default=False)]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Any key of the configuration by its dotted path."),
]
Output = Annotated[
    Path | None, typer.Option("-o", "--output", help="Folder for what is made; must not hold a run yet.")
]


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command("run")(run)
    app.command("replay")(replay)
    app.command("view")(view)
    app.command("simulate")(simulate)


def run(
    config: Annotated[
        Path | None, typer.Argument(help="Configuration, a TOML file.", show_default=False)
    ] = None,
    output: Output = None,
    runs: Annotated[int | None, typer.Option(help="Number of runs, instead of session.runs.", min=1)] = None,
    set_: Set = None,
    view: Annotated[bool, typer.Option("--view", help="Open the live view in a window.")] = False,
    resume: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Go on with an interrupted session; no CONFIG then.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Measure although preflight says no-go.")] = False,
    json_lines: Annotated[bool, typer.Option("--json", help="One JSON object a line on stdout.")] = False,
) -> None:
    """Run a measurement session: record, fit, results."""
    from rig.measure import measure_session, resume_session
    from rig.settings import load_configuration

    if resume is not None:
        if config is not None or output is not None or set_:
            raise typer.BadParameter("--resume takes its configuration from DIR: name no other")
        raise typer.Exit(resume_session(resume, force=force, json_lines=json_lines))
    if config is None:
        raise typer.BadParameter("Missing argument 'CONFIG'.")

    overrides = list(set_ or [])
    if runs is not None:
        overrides.append(f"session.runs={runs}")
    if view:
        overrides.append('view.mode="spawn"')
    raise typer.Exit(
        measure_session(
            load_configuration(config, overrides), config, output, force=force, json_lines=json_lines
        )
    )


def replay(
    record: Record,
    output: Output = None,
    speed: Annotated[
        str, typer.Option(metavar="1|10|max", help="Seconds of the record in a second, any number.")
    ] = "max",
    from_s: Annotated[float, typer.Option("--from", help="Begin so many seconds after the start.")] = 0.0,
    to_s: Annotated[
        float | None, typer.Option("--to", help="End so many seconds after the start.", show_default=False)
    ] = None,
    retrack: Annotated[
        bool, typer.Option("--retrack", help="Track again, from the recorded windows.")
    ] = False,
    view: Annotated[bool, typer.Option("--view", help="Open the live view.")] = False,
    mode: Annotated[
        Literal["spawn", "web"], typer.Option(help="With --view: a window, or a page on loopback.")
    ] = "spawn",
    rrd: Annotated[Path | None, typer.Option(help="Draw into a Rerun file.")] = None,
    set_: Set = None,
) -> None:
    """Put a record through the pipeline again and compare with what was recorded.

    In a terminal: space pauses, → or n goes on by a frame, h by a half-cycle, + and - by 10 s, g to a
    time, q ends.
    """
    from rig.replay import replay_record

    raise typer.Exit(
        replay_record(
            record,
            output,
            retrack=retrack,
            overrides=set_ or [],
            speed=speed,
            from_s=from_s,
            to_s=math.inf if to_s is None else to_s,
            mode=mode if view else "none",
            rrd=rrd,
        )
    )


def view(
    records: Annotated[list[Path], typer.Argument(help="Records (.mcap) or a Rerun file (.rrd).")],
    mode: Annotated[
        Literal["spawn", "web"], typer.Option(help="A window, or a page on loopback for a browser.")
    ] = "spawn",
    rrd: Annotated[Path | None, typer.Option(help="Write a Rerun file instead of opening anything.")] = None,
    layout: Annotated[
        Literal["balancing", "measuring", "analysing"],
        typer.Option(help="What is laid out; analysing fits what was not fitted yet."),
    ] = "measuring",
) -> None:
    """Show recorded runs in Rerun; several are laid over each other, aligned at their start."""
    from rig.view import show_records

    show_records(records, mode=mode, rrd=rrd, layout=layout)


def simulate(
    config: Config,
    output: Annotated[Path, typer.Option("-o", "--output", help="Record to make, an MCAP file.")],
    set_: Set = None,
) -> None:
    """Record one run of the simulated rig, without fits."""
    from rig.measure import simulate_record
    from rig.settings import load_configuration

    raise typer.Exit(simulate_record(load_configuration(config, set_ or []), config, output))
