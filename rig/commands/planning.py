"""`rig plan`."""

from pathlib import Path
from typing import Annotated

import typer

from processing.errors import ConfigurationError
from rig.commands.arguments import (
    Set,
    folder_without,
    in_json,
    is_of_table,
    one_record,
    output_option,
    recorded_or_fitted,
    there,
)


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command()(in_json(plan))


def plan(
    source: Annotated[
        Path,
        typer.Argument(
            help="A run of this rig (.mcap) or its folder, a fitted table's, or a configuration (TOML).",
            show_default=False,
            callback=recorded_or_fitted,
        ),
    ],
    first: Annotated[
        list[float] | None, typer.Option(min=0.1, help="First amplitude, arcsec; may be repeated.")
    ] = None,
    last: Annotated[
        list[float] | None, typer.Option(min=0.1, help="Last amplitude, arcsec; may be repeated.")
    ] = None,
    ground: Annotated[
        float | None,
        typer.Option(min=0.0, help="Drive of another ground, rad/s2/sqrt(Hz); default: from SOURCE."),
    ] = None,
    output: Annotated[
        Path | None,
        output_option("Folder for the table and the picture.", folder_without("plan.*")),
    ] = None,
    set_: Set = None,
    runs: Annotated[
        list[int] | None, typer.Option(min=1, help="Number of runs; may be repeated; default: 1.")
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(min=0.0, help="Configuration: noise of one frame, arcsec, if known."),
    ] = None,
    contact: Annotated[
        Path | None,
        typer.Option(help="Configuration: results.json with the expected contact.", callback=there),
    ] = None,
    witness: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Noise of a seismometer over the ground it sees, at the swing's frequency: 0.1; "
            "default: that of [witness].",
        ),
    ] = None,
    wait: Annotated[
        list[float] | None,
        typer.Option(
            min=0.0, help="Minutes between runs that reveal ageing; may be repeated; default: 0, 60."
        ),
    ] = None,
) -> None:
    """Predict how well further runs would determine the contact.

    Uncertainties against first and last amplitude, number of runs and rig time, from a run of this rig, a
    fitted table or film, or a configuration; then which two successive runs reveal ageing of the contact,
    which a single decay cannot.

    \b
    Examples:
      rig plan runs/first/run-1.mcap --first 124 --last 2 -o plans
      rig plan configs/basement.toml --runs 1 --runs 3
      rig plan fits/decay
      rig plan configs/basement.toml --witness 0.05
    """
    firsts, lasts = first or [300.0, 124.0, 60.0], last or [30.0, 15.0, 8.0, 4.0, 2.0]
    counts = runs or [1]
    if min(lasts) >= max(firsts):
        raise ConfigurationError(
            f"--last {min(lasts):g}: should be below the first amplitude, {max(firsts):g} arcsec; name a "
            "smaller one, or a larger --first"
        )

    from rig.report import (
        ageing_table,
        make_plan,
        plan_table,
        planned_contact_of_file,
        planned_contact_of_run,
        planned_contact_of_table,
        save_plan,
    )
    from rig.terminal import print_tables, say

    if source.suffix.lower() == ".toml":
        expected = planned_contact_of_file(source, set_ or [], noise, contact)
    elif is_of_table(source):
        if noise is not None or contact is not None or set_:
            raise ConfigurationError(
                f"{source}: a table's results have their own noise, contact and configuration; leave out "
                "--noise, --contact and --set"
            )
        expected = planned_contact_of_table(source)
        say("without the waveform of the swings, which results do not hold: uncertainties are upper limits")
    else:
        from rig.analysis import analyse_record, refuse_unread

        if noise is not None or contact is not None:
            raise ConfigurationError(
                f"{source}: a record has its own noise and contact; leave out --noise and --contact"
            )
        run = analyse_record(one_record(source), set_ or [])
        expected = planned_contact_of_run(run)
        refuse_unread([run])
    planned = make_plan(expected, firsts, lasts, ground, counts, witness)
    waits_s = [60.0 * minutes for minutes in ([0.0, 60.0] if wait is None else wait)]
    ageing = ageing_table(planned, waits_s)
    print_tables([plan_table(planned), ageing])
    if output is not None:
        save_plan(planned, output, ageing)
