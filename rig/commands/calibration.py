"""`rig calibrate`."""

import inspect
from collections.abc import Callable
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rig.commands.inputs import one_record, recorded, there
from rig.commands.json_answers import in_json
from rig.commands.outputs import folder_without, output_option

if TYPE_CHECKING:
    from rig.calibrate import Filing

AskedLadder = Annotated[
    Path,
    typer.Argument(
        help="Steps or geometry of the lever (TOML file); without it, you are asked.",
        show_default=False,
        callback=there,
    ),
]
AskedRecord = Annotated[
    Path,
    typer.Argument(
        help="Record (MCAP file), or a folder with one; without it, you are asked.",
        show_default=False,
        callback=recorded,
    ),
]
Rig = Annotated[
    Path | None,
    typer.Option(
        "--config",
        help="Configuration of the rig, to make the recordings asked for.",
        show_default=False,
        callback=there,
    ),
]
Folder = Annotated[Path, output_option("Folder for the calibration file.", folder_without())]
Days = Annotated[
    float, typer.Option("--valid-days", help="Number of days for which the calibration is valid.")
]
By = Annotated[str, typer.Option("--by", help="Who made the calibration; default: the user's name.")]
Side = Annotated[
    Literal["+", "-"] | None,
    typer.Option(help="Sign of this mode's deflection in the first frame of the record."),
]
Made = Callable[..., Path]
"""What makes a calibration of a file or record, of a `Filing` and of options of its own, in the order of the
command's help; its docstring is that help.
"""


def register(app: typer.Typer) -> None:
    """Add `rig calibrate`."""
    group = typer.Typer(help="Make a calibration file.", no_args_is_help=True)
    for made in (lever, axes, sensor, clock, shutter, air, pointing, check):
        group.command()(in_json(_command(made)))
    app.add_typer(group, name="calibrate")


def lever(ladder: AskedLadder, filing: "Filing") -> Path:
    """Calibrate pixels to radians.

    From geometry, known tilts or known shifts of the sensor. Without a file it asks step by step, and
    continues where it was interrupted.

    \b
    Examples:
      rig calibrate lever geometry.toml
      rig calibrate lever --config mine.toml
    """
    from rig.calibrate import calibrate_lever

    return calibrate_lever(ladder, filing)


def axes(record: AskedRecord, filing: "Filing", slow_began: Side = None, fast_began: Side = None) -> Path:
    """Find the directions of both modes on the sensor.

    From a record in which both swing; without one it asks step by step.

    \b
    Example:
      rig calibrate axes both-modes.mcap --slow-began +
    """
    from rig.calibrate import calibrate_axes

    return calibrate_axes(one_record(record), filing, slow_began, fast_began)


def sensor(
    frames: Annotated[
        Path,
        typer.Argument(
            help="List of dark and evenly lit frames (TOML file); without it, you are asked.",
            show_default=False,
            callback=there,
        ),
    ],
    filing: "Filing",
) -> Path:
    """Measure the sensor: gain, read noise, dark level.

    By photon transfer. Without a file it asks step by step, and takes the frames if --config is stated.

    \b
    Example:
      rig calibrate sensor frames.toml
    """
    from rig.calibrate import calibrate_sensor

    return calibrate_sensor(frames, filing)


def clock(
    record: AskedRecord,
    filing: "Filing",
    counter_bits: Annotated[
        int | None,
        typer.Option(
            help="Width in bits of the camera's nanosecond counter, if it rolls over.", min=16, max=62
        ),
    ] = None,
) -> Path:
    """Compare the camera's clock with the host's.

    Without a record it asks step by step.

    \b
    Example:
      rig calibrate clock runs/first/run-1.mcap
    """
    from rig.calibrate import calibrate_clock

    return calibrate_clock(one_record(record), filing, counter_bits)


def shutter(record: AskedRecord, filing: "Filing") -> Path:
    """Measure the row time of a rolling shutter.

    From a run in which the spot swings across the rows; without one it asks step by step.
    """
    from rig.calibrate import calibrate_shutter

    return calibrate_shutter(one_record(record), filing)


def air(
    vanes: Annotated[
        Path,
        typer.Argument(
            help="Runs with their vanes or pressures (TOML file); without it, you are asked.",
            show_default=False,
            callback=there,
        ),
    ],
    filing: "Filing",
) -> Path:
    """Measure the drag of the air.

    From runs with vanes of stated areas on the pendulum, or at stated pressures. Without a file it says
    which vanes to cut and where to put them (with --config for this pendulum), and asks for one run after
    the other.

    \b
    Example:
      rig calibrate air vanes.toml
    """
    from rig.calibrate import calibrate_air

    return calibrate_air(vanes, filing)


def pointing(record: AskedRecord, filing: "Filing") -> Path:
    """Measure noise and drift of the spot, the pendulum clamped.

    Without a record it asks step by step.

    \b
    Example:
      rig calibrate pointing clamped.mcap
    """
    from rig.calibrate import calibrate_pointing

    return calibrate_pointing(one_record(record), filing)


def check(
    ladder: Annotated[
        Path,
        typer.Argument(
            help="Known tilts (TOML file); without it, you are asked.", show_default=False, callback=there
        ),
    ],
    *,
    lever: Annotated[
        Path | None,
        typer.Option(help="Calibration file of the lever to be checked.", show_default=False, callback=there),
    ] = None,
    filing: "Filing",
) -> Path:
    """Check the lever against known tilts.

    Before and after a series. Without a file it asks step by step.

    \b
    Example:
      rig calibrate check tilts.toml --lever calibrations/lever-001.toml
    """
    from rig.calibrate import check_known_angle

    if lever is None:
        raise typer.BadParameter(f"is missing: which lever shall {ladder} check?", param_hint="--lever")
    return check_known_angle(ladder, lever, filing)


def _filing(output: Folder = Path("calibrations"), valid_days: Days = 90.0, by: By = "") -> "Filing":
    from rig.calibrate import Filing

    return Filing(output, valid_days, by)


def _command(made: Made) -> Callable[..., None]:
    """The command of a calibration: it has the options of `_filing`, and asks where no file is named."""
    named, *others = inspect.signature(made).parameters.values()
    of_filing = inspect.signature(_filing).parameters

    def command(config: Rig = None, **stated: Any) -> None:
        filing = _filing(**{name: stated.pop(name) for name in of_filing})
        given: Path | None = stated.pop(named.name)
        if given is not None:
            _say(made(given, filing=filing, **stated))
            return
        if lever := stated.get("lever"):
            raise typer.BadParameter(f"{lever}: is asked for without a file of tilts; leave the option out")
        _say(_asked(made.__name__, config, filing))

    parameters = [named.replace(default=None)]
    for other in others:
        parameters += of_filing.values() if other.name == "filing" else [other]
    parameters.append(inspect.signature(command).parameters["config"])
    kind = inspect.Parameter.KEYWORD_ONLY
    signature = inspect.Signature([parameter.replace(kind=kind) for parameter in parameters])
    command.__name__, command.__doc__ = made.__name__, made.__doc__
    vars(command)["__signature__"] = signature
    return command


def _asked(kind: str, config: Path | None, filing: "Filing") -> Path:
    """Ask for what is needed, record it where a configuration is stated, and make the calibration.

    The answers are kept until it is made, so that the same command goes on after a break.
    """
    import sys

    from processing.errors import RigError
    from rig.presentation import say
    from rig.settings import load_configuration
    from rig.wizards import (
        as_far_as_it_holds,
        ask_in_terminal,
        calibration_wizard,
        drop_draft,
        keep_draft,
        kept_draft,
        progress,
        recorder_of,
    )

    loaded = None if config is None else load_configuration(config)
    wizard = calibration_wizard(kind, loaded)
    recorder = None if loaded is None or config is None else recorder_of(loaded, config, filing.folder)
    kept = filing.folder / f"{kind}-answers.json"
    draft = as_far_as_it_holds(wizard, kept_draft(kept))
    if draft.answers:
        say(f"continues after the {len(draft.answers)} answers in {kept}; remove that file to start over")
    while True:
        draft = ask_in_terminal(wizard, draft, lambda answers: keep_draft(kept, answers), recorder)
        try:
            path = wizard.file(progress(wizard, draft).values, filing)
        except RigError as error:
            draft = draft.without_last()
            keep_draft(kept, draft)
            if not sys.stdin.isatty():
                raise
            say(f"{error}\nthe last question once more; < goes further back")
        else:
            drop_draft(kept)
            return path


def _say(path: Path) -> None:
    """Print the content of the new file."""
    from rig.presentation import answer, print_line, print_tables
    from rig.wizards import filed

    made = filed(path)
    found = made.calibration
    answer(calibration=found.model_dump(mode="json"), written=[path])
    print_line(f"{found.kind}: {found.method}, valid until {found.valid_until:%Y-%m-%d}")
    said = {**found.values, **found.details}
    open_ends = {name for name, value in said.items() if isinstance(value, float) and not isfinite(value)}
    for name, value in said.items():
        if {name, f"u_{name}"} & open_ends and not name.endswith("_dof"):
            print_line(f"  {name:24} not determined")
        elif isinstance(value, bool | str):
            print_line(f"  {name:24} {value}")
        elif isinstance(value, int | float):
            print_line(f"  {name:24} {value:.6g}")
    print_tables([table for table in made.tables if table.name != "values"])
    for note in found.notes:
        print_line(f"note: {note}")
    print(path)
