"""Commands that make, replay and show records."""

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Literal

import typer

from processing.errors import ConfigurationError
from rig.commands.arguments import (
    MODES,
    JsonLines,
    Record,
    ResultsFolder,
    Set,
    View,
    configuration_of,
    existing,
    folder_or_record,
    folder_without_run,
    in_json,
    input_argument,
    input_option,
    new_file,
    one_record,
    output_option,
)

Rrd = Annotated[Path | None, output_option("Write a Rerun file.", new_file(".rrd"), names=("--rrd",))]
RunsFolder = Annotated[
    Path | None, output_option("Folder for the files written; must not hold a run yet.", folder_without_run)
]


def demo(
    output: RunsFolder = None,
    set_: Set = None,
    view: View = None,
    json_lines: JsonLines = False,
) -> None:
    """Measure on a simulated rig: no instrument is needed.

    From camera frames to the report, in about a minute; the first start also compiles the numerical
    kernels. rig init --example demo writes the configuration, to be edited and given to rig run.

    \b
    Example:
      rig demo
    """
    from rig.settings import shipped

    run([shipped("demo")], output, set_=set_, view=view, json_lines=json_lines)


def run(
    configs: Annotated[
        list[Path] | None,
        input_argument(
            "Configuration (TOML file); of several, one session after the other.",
            metavar="CONFIG",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        output_option(
            "Folder for the files written, without a run yet; or one new record.", folder_or_record
        ),
    ] = None,
    runs: Annotated[int | None, typer.Option(help="Number of runs; default: session.runs.", min=1)] = None,
    set_: Set = None,
    view: View = None,
    resume: Annotated[
        Path | None,
        input_option("Continue the interrupted session in DIR, without CONFIG.", metavar="DIR"),
    ] = None,
    instead: Annotated[
        Path | None,
        input_option(
            "With --resume: another configuration for the missing runs.", "--config", metavar="FILE"
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Measure even if a preflight check fails.")] = False,
    record_only: Annotated[
        bool,
        typer.Option("--record-only", help="Record one run into the file -o NAME.mcap, without fits."),
    ] = False,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=1,
            help="With --record-only: for so long, the pendulum as it is, without preflight and start.",
        ),
    ] = None,
    json_lines: JsonLines = False,
) -> None:
    """Measure a session: record, fit, report.

    \b
    Examples:
      rig run configs/demo.toml -o runs/first --view web
      rig run mine.toml --runs 3 --set session.sample="steel on K8"
      rig run --resume runs/first
      rig run --resume runs/first --set camera.exposure_us=80
      rig run --resume runs/first --config corrected.toml
      rig run steel.toml silicon.toml -o runs/night
      rig run mine.toml --record-only -o clamped.mcap --seconds 120
    """
    configs = configs or []
    if record_only:
        _check_record_options(configs, output, runs, resume, view)
    elif seconds is not None:
        raise ConfigurationError(f"--seconds {seconds:g}: has no effect without --record-only")
    elif output is not None and output.suffix.lower() == ".mcap":
        raise ConfigurationError(f"{output}: one record is written with --record-only; else name a folder")
    if instead is not None and resume is None:
        raise typer.BadParameter("--config goes with --resume DIR; else name the file as CONFIG")
    if not configs and resume is None:
        raise typer.BadParameter("Missing argument 'CONFIG'.")

    if resume is not None:
        if configs or output is not None or runs is not None or view:
            raise typer.BadParameter(
                "--resume takes its configuration from DIR: leave out CONFIG and options but --set, --force, "
                "--json, --config FILE"
            )
        from rig.measure import resume_session

        raise typer.Exit(resume_session(resume, instead, set_ or [], force=force, json_lines=json_lines))

    overrides = list(set_ or [])
    if runs is not None:
        overrides.append(f"session.runs={runs}")
    if view:
        overrides.append(f'view.mode="{MODES[view]}"')
    if len(configs) > 1:
        from rig.measure import measure_sessions

        raise typer.Exit(measure_sessions(configs, overrides, output, force=force, json_lines=json_lines))

    (config,) = configs
    configuration = configuration_of(config, overrides)
    # imported after the configuration is checked, because it takes a second
    from rig.measure import measure_session, record_plainly
    from rig.terminal import one_json_object

    if record_only:
        assert output is not None
        with one_json_object() if json_lines else nullcontext():
            record_plainly(configuration, config, output, seconds)
        return
    raise typer.Exit(measure_session(configuration, config, output, force=force, json_lines=json_lines))


def _check_record_options(configs: list[Path], output: Path | None, *others: object) -> None:
    """Raise an error if `--record-only` is not with one configuration and one new record alone."""
    if len(configs) != 1 or output is None or any(others):
        raise typer.BadParameter(
            "--record-only takes CONFIG, -o NAME.mcap, --seconds and --set alone: it records one run"
        )
    if output.suffix.lower() != ".mcap":
        raise ConfigurationError(f"{output}: name a file that ends in .mcap")


@in_json
def replay(
    record: Record,
    output: ResultsFolder = None,
    retrack: Annotated[
        bool, typer.Option("--retrack", help="Track the spot again, in the recorded pixels.")
    ] = False,
    set_: Set = None,
) -> None:
    """Process a record again and compare with what was recorded.

    \b
    Examples:
      rig replay runs/first/run-1.mcap
      rig replay runs/first/run-1.mcap --retrack --set sensor.read_noise_e=40
    """
    from rig.view import replay_record

    raise typer.Exit(replay_record(one_record(record), output, retrack=retrack, overrides=set_ or []))


@in_json
def view(
    record: Annotated[Path, typer.Argument(help="Record (.mcap), or its folder.")],
    view: View = None,
    rrd: Rrd = None,
    layout: Annotated[
        Literal["balancing", "measuring", "analysing"],
        typer.Option(help="Layout of the panels; analysing fits a record that has no results yet."),
    ] = "measuring",
    follow: Annotated[bool, typer.Option("--follow", hidden=True)] = False,
    ports: Annotated[tuple[int, int] | None, typer.Option(hidden=True)] = None,
) -> None:
    """Show a record in Rerun; one that is being written is followed.

    \b
    Examples:
      rig view runs/first/run-1.mcap --view web
      rig view runs/first/run-1.mcap --layout analysing --rrd fits.rrd
    """
    from rig.view import show_record

    if rrd is not None and view:
        raise ConfigurationError(f"--view {view} --rrd {rrd}: written or shown, not both; leave one out")
    # a followed record may not exist yet
    path = record if follow else one_record(existing(record))
    mode: Literal["spawn", "web"] = "web" if view == "web" else "spawn"
    show_record(path, mode=mode, rrd=rrd, layout=layout, follow=follow, ports=ports)
    if rrd is not None and not follow:
        from rig.terminal import answer

        answer(written=[rrd])
        print(f"Rerun file   {rrd}")
