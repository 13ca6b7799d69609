"""`rig fit`, `rig plan`, `rig instruments`."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from processing.errors import ConfigurationError
from rig.commands.arguments import ResultsFolder, Set
from rig.commands.films import table_report
from rig.commands.inputs import (
    is_of_table,
    one_record,
    recorded,
    recorded_or_fitted,
    records_in,
    there,
    with_results,
)
from rig.commands.json_answers import in_json
from rig.commands.outputs import folder_without

if TYPE_CHECKING:
    from rig.analysis import StatedWitness


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    for command in (fit, plan, instruments):
        app.command()(in_json(command))


def fit(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Records (.mcap), their folders, or one table of positions (CSV).",
            show_default=False,
            callback=recorded,
        ),
    ],
    output: ResultsFolder = None,
    config: Annotated[
        Path | None, typer.Option(help="CSV: configuration with [pendulum] and [fit].", callback=there)
    ] = None,
    time: Annotated[str | None, typer.Option(help="CSV: name or number of the column with the time.")] = None,
    time_unit: Annotated[
        str,
        typer.Option(
            help="CSV: unit of the time: ns (also absolute), us, ms, s, min, h, d; default: as its header "
            "says (time_ms, t [ms]), else s.",
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
        typer.Option(min=0.0, help="CSV without times: rows a second, in Hz."),
    ] = None,
    begin: Annotated[
        float | None, typer.Option("--from", help="CSV: use it from here on, in s since its first row.")
    ] = None,
    end: Annotated[
        float | None, typer.Option("--to", help="CSV: use it up to here, in s since its first row.")
    ] = None,
    decimal: Annotated[
        str, typer.Option(help="CSV: the decimal mark, point or comma, where its numbers leave that open.")
    ] = "",
    run: Annotated[
        str, typer.Option(help="CSV with several runs: the one to use, by its number; default: all.")
    ] = "",
    envelope: Annotated[
        str | None,
        typer.Option(help="CSV: the column is an envelope: amplitude, or power in dB."),
    ] = None,
    frequency: Annotated[
        float | None, typer.Option(min=0.0, help="CSV: frequency in Hz of what an envelope is of.")
    ] = None,
    law: Annotated[
        list[str] | None,
        typer.Option(help="Compare the paper's law with another one, all or none; may be repeated."),
    ] = None,
    witness: Annotated[
        Path | None,
        typer.Option(
            help="What a seismometer or tiltmeter recorded beside the run: CSV (time_s and columns in any "
            "unit), miniSEED, SAC.",
            callback=there,
        ),
    ] = None,
    witness_column: Annotated[
        list[str] | None,
        typer.Option(help="Column or channel of the witness; may be repeated; default: all of them."),
    ] = None,
    witness_offset: Annotated[
        float | None,
        typer.Option(help="Seconds to add to the witness's times; default: found where they do not fit."),
    ] = None,
    set_: Set = None,
) -> None:
    """Fit the contact laws to records, or to a CSV table.

    \b
    Examples:
      rig fit runs/first -o runs/fit
      rig fit decay.csv --unit arcsec --config mine.toml
      rig fit runs/first --witness seismometer.csv
    """
    ground = _witness(witness, witness_column or (), witness_offset)
    if len(files) == 1 and files[0].suffix.lower() != ".mcap" and not files[0].is_dir():
        if files[0].suffix.lower() in (".json", ".toml"):
            raise ConfigurationError(
                f"{files[0]}: is no table; name a record (.mcap), or the table before --config CONFIG"
            )
        from rig.analysis import TableColumns, fit_envelope_table, fit_trajectory

        if law and (config is None or envelope is not None):
            raise ConfigurationError(f"--law {law[0]}: laws need swings and --config CONFIG with [pendulum]")
        if set_ and (config is None or envelope is not None):
            raise ConfigurationError(f"--set {set_[0]}: has no effect without --config")
        if decimal not in ("", ".", ","):
            raise ConfigurationError(f"--decimal {decimal!r}: a point or a comma")
        if rate is not None and not rate > 0:
            raise ConfigurationError(f"--rate {rate:g}: rows a second are more than 0")
        columns = TableColumns(time, tuple(position or ()), unit, time_unit, rate, begin, end, decimal, run)
        if ground is not None and (config is None or envelope is not None):
            raise ConfigurationError("--witness: has no effect without --config, which gives the pendulum")
        if envelope is not None:
            raise typer.Exit(fit_envelope_table(files[0], output, columns, envelope, frequency))
        raise typer.Exit(
            fit_trajectory(files[0], output, config, columns, set_ or [], table_report, law or [], ground)
        )
    of_tables = {
        "--config": config, "--time": time, "--position": position, "--unit": unit, "--envelope": envelope,
        "--frequency": frequency, "--rate": rate, "--from": begin, "--to": end, "--decimal": decimal,
        "--run": run,
    }  # fmt: skip
    if stated := next((name for name, value in of_tables.items() if value), ""):
        raise ConfigurationError(f"{stated}: has no effect on records, only on a table; leave it out")
    records = [record for path in files for record in records_in(path)]
    same = [record for record in records if sum(record.resolve() == other.resolve() for other in records) > 1]
    if same:
        raise ConfigurationError(f"{same[0]}: named twice; a run counts once in a series")
    raise typer.Exit(fit_records(records, output, overrides=set_ or [], laws=law or [], witness=ground))


def _witness(path: Path | None, columns: Sequence[str], offset_s: float | None) -> "StatedWitness | None":
    from rig.analysis import StatedWitness

    if path is not None:
        return StatedWitness(path, tuple(columns), offset_s)
    if stated := "--witness-column" if columns else "--witness-offset" if offset_s is not None else "":
        raise ConfigurationError(f"{stated}: has no effect without --witness")
    return None


def fit_records(
    paths: Sequence[Path],
    output: Path | None,
    overrides: Sequence[str],
    laws: Sequence[str] = (),
    witness: "StatedWitness | None" = None,
) -> int:
    """Fit records; results.json in `output` or beside the first record. Returns the exit status.

    `laws` are names of the registry, to be compared with the default one; `witness` saw the ground.
    """
    from rig.analysis import (
        RESULTS_NAME,
        analyse_record,
        chosen_laws,
        free_path,
        laws_of,
        print_results,
        session_results,
        write_results,
    )
    from rig.presentation import say

    compared = chosen_laws(laws) if laws else ()
    refuse_copies(paths)
    ground = None if witness is None else witness.read()
    runs = [analyse_record(path, overrides, witness=ground) for path in paths]
    for run in runs:
        if run.earlier_schema:
            say(run.earlier_schema)
    if compared:
        runs = [replace(run, results=replace(run.results, laws=laws_of(run, compared))) for run in runs]
    folder = output or paths[0].parent
    results = session_results(runs, folder)
    folder.mkdir(parents=True, exist_ok=True)
    target = free_path(folder) if output is None else folder / RESULTS_NAME
    write_results(target, results)
    print_results(results, [("results", target)])
    return 1 if any(run.problem for run in results.runs) else 0


def refuse_copies(paths: Sequence[Path]) -> None:
    """Raise ConfigurationError where two records are the same run: one was copied, or thinned."""
    from acquisition.record.proof import measured_sha256_of

    first: dict[str, Path] = {}
    for path in paths if len(paths) > 1 else ():
        other = first.setdefault(measured_sha256_of(path), path)
        if other is not path:
            raise ConfigurationError(
                f"{path}: holds the run of {other} (same hash), which counts once in a series"
            )


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
        typer.Option(min=0.0, help="Drive of another ground, rad/s2/sqrt(Hz); default: what SOURCE says."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Folder for the picture, or the plan.",
            callback=folder_without("plan.*", "plan-*.toml"),
        ),
    ] = None,
    set_: Set = None,
    runs: Annotated[
        list[int] | None, typer.Option(min=1, help="Number of runs; may be repeated; default: 1.")
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(min=0.0, help="Configuration: noise of one frame, arcsec, where it is known."),
    ] = None,
    contact: Annotated[
        Path | None,
        typer.Option(help="Configuration: results.json with the contact that is expected.", callback=there),
    ] = None,
    witness: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Noise of a witness of the ground over the ground it sees, at the swing's frequency: 0.1.",
        ),
    ] = None,
    wait: Annotated[
        list[float] | None,
        typer.Option(min=0.0, help="Minutes between runs that tell ageing; may be repeated; default: 0, 60."),
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option(
            "--for",
            metavar="TARGET",
            help="Choose runs that reach it soonest: 'u(c)/c<0.05', or two forms; may be repeated.",
        ),
    ] = None,
    campaign: Annotated[
        Path | None, typer.Option(help="With --for: what is stated (campaign.toml).", callback=there)
    ] = None,
    after: Annotated[
        list[Path] | None,
        typer.Option(
            help="With --for: a folder of runs of the sample that were made; may be repeated.",
            callback=with_results,
        ),
    ] = None,
    sample: Annotated[
        list[str] | None,
        typer.Option(help="With --for: a sample to measure; may be repeated; default: session.sample."),
    ] = None,
    hours: Annotated[
        float | None, typer.Option(min=0.1, help="With --for: rig time that the runs may take.")
    ] = None,
) -> None:
    """Show what runs to come will tell of the contact.

    Uncertainties over first and last amplitudes, number of runs and rig time, from a run of this rig, a table
    or film that was fitted, or a configuration; then which two runs, one after the other, tell a contact
    that ages, which one decay cannot.

    \b
    Examples:
      rig plan runs/first/run-1.mcap --first 124 --last 2 -o plans
      rig plan configs/basement.toml --runs 1 --runs 3
      rig plan fits/decay
      rig plan configs/basement.toml --witness 0.05
      rig plan configs/basement.toml --for "u(c)/c<0.05" --hours 10 -o plans
    """
    if not target:
        stated = {"--campaign": campaign, "--after": after, "--sample": sample, "--hours": hours}
        if given := next((name for name, value in stated.items() if value), ""):
            raise ConfigurationError(f"{given}: has no effect without --for TARGET")
    firsts, lasts = first or [300.0, 124.0, 60.0], last or [30.0, 15.0, 8.0, 4.0, 2.0]
    counts = runs or [1]
    if min(lasts) >= max(firsts):
        raise ConfigurationError(
            f"--last {min(lasts):g}: should be below the first amplitude, {max(firsts):g} arcsec; name a "
            "smaller one, or a larger --first"
        )

    if target:
        if source.suffix.lower() != ".toml":
            raise ConfigurationError(
                f"{source}: --for plans runs of a configuration; name its TOML file, and what was found by "
                "--contact or --after"
            )
        if runs is not None:
            raise ConfigurationError("--runs: --for chooses how many; leave it out, or limit --hours")
        from rig.campaigns import AskedPlan
        from rig.commands.planned_for import plan_for

        asked = AskedPlan(
            source=source, targets=target, first_arcsec=firsts, last_arcsec=lasts, overrides=set_ or [],
            noise_arcsec=noise, contact=contact, ground_rad_per_s2_rthz=ground, witness=witness,
            waits_min=wait, campaign=campaign, samples=sample or [],
        )  # fmt: skip
        plan_for(asked, after or [], hours, output)
        return

    from rig.plan import (
        ageing_table,
        expected_of_table,
        plan_ageing,
        plan_expected,
        plan_runs,
        planned_expectation,
        print_plan,
        save_plan,
    )
    from rig.presentation import say

    if source.suffix.lower() == ".toml":
        expected = planned_expectation(source, set_ or [], noise, contact)
        planned = plan_expected(expected, firsts, lasts, ground, counts, witness)
    elif is_of_table(source):
        if noise is not None or contact is not None or set_:
            raise ConfigurationError(
                f"{source}: a table's results have their own noise, contact and configuration; leave out "
                "--noise, --contact and --set"
            )
        planned = plan_expected(expected_of_table(source), firsts, lasts, ground, counts, witness)
        say("without the waveform of the swings, which results do not hold: uncertainties are upper limits")
    else:
        from rig.analysis import analyse_record, refuse_unread
        from rig.sealing import refuse_blind

        refuse_blind(source, "a plan from what it found")

        if noise is not None or contact is not None:
            raise ConfigurationError(
                f"{source}: a record has its own noise and contact; leave out --noise and --contact"
            )
        run = analyse_record(one_record(source), set_ or [])
        planned = plan_runs(run, firsts, lasts, ground, counts, witness)
        refuse_unread([run])
    waits_s = [60.0 * minutes for minutes in ([0.0, 60.0] if wait is None else wait)]
    ageing = ageing_table(plan_ageing(planned, waits_s))
    print_plan(planned, ageing)
    if output is not None:
        save_plan(planned, output, ageing)


def instruments() -> None:
    """List the kinds of pendulum, for instrument.kind."""
    from processing.instruments import INSTRUMENTS
    from rig.presentation import answer, print_line

    answer(instruments={each.kind: each.sentence for each in INSTRUMENTS.values()})
    for description in INSTRUMENTS.values():
        print_line(f"{description.kind:<15} {description.sentence}")
