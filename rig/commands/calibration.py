"""`rig calibrate`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rig.commands.arguments import Record, one_record

if TYPE_CHECKING:
    from rig.calibrate import Filing

Ladder = Annotated[
    Path, typer.Argument(help="Steps or geometry of the lever (TOML file).", show_default=False)
]
Folder = Annotated[Path, typer.Option("-o", "--output", help="Folder for the calibration file.")]
Days = Annotated[
    float, typer.Option("--valid-days", help="Number of days for which the calibration is valid.", min=0.01)
]
By = Annotated[str, typer.Option("--by", help="Who made the calibration; default: the user's name.")]
Side = Annotated[
    Literal["+", "-"] | None,
    typer.Option(help="Sign of this mode's deflection in the first frame of the record."),
]
_FOLDER = Path("calibrations")
_DAYS = 90.0


def register(app: typer.Typer) -> None:
    """Add `rig calibrate`."""
    group = typer.Typer(help="Make a calibration file.", no_args_is_help=True)
    group.command("lever")(lever)
    group.command("axes")(axes)
    group.command("sensor")(sensor)
    group.command("clock")(clock)
    group.command("shutter")(shutter)
    group.command("pointing")(pointing)
    group.command("check")(check)
    app.add_typer(group, name="calibrate")


def lever(ladder: Ladder, output: Folder = _FOLDER, valid_days: Days = _DAYS, by: By = "") -> None:
    """Calibrate pixels to radians.

    From geometry, known tilts or known shifts of the sensor.

    \b
    Example:
      rig calibrate lever geometry.toml
    """
    from rig.calibrate import calibrate_lever

    _say(calibrate_lever(ladder, _filing(output, valid_days, by)))


def axes(
    record: Record,
    output: Folder = _FOLDER,
    valid_days: Days = _DAYS,
    by: By = "",
    slow_began: Side = None,
    fast_began: Side = None,
) -> None:
    """Find the directions of both modes on the sensor.

    From a record in which both swing.

    \b
    Example:
      rig calibrate axes both-modes.mcap --slow-began +
    """
    from rig.calibrate import calibrate_axes

    _say(calibrate_axes(one_record(record), _filing(output, valid_days, by), slow_began, fast_began))


def sensor(
    frames: Annotated[
        Path, typer.Argument(help="List of dark and evenly lit frames (TOML file).", show_default=False)
    ],
    output: Folder = _FOLDER,
    valid_days: Days = _DAYS,
    by: By = "",
) -> None:
    """Measure the sensor: gain, read noise, dark level.

    By photon transfer.

    \b
    Example:
      rig calibrate sensor frames.toml
    """
    from rig.calibrate import calibrate_sensor

    _say(calibrate_sensor(frames, _filing(output, valid_days, by)))


def clock(
    record: Record,
    output: Folder = _FOLDER,
    valid_days: Days = _DAYS,
    by: By = "",
    counter_bits: Annotated[
        int | None,
        typer.Option(
            help="Width in bits of the camera's nanosecond counter, where it rolls over.", min=16, max=62
        ),
    ] = None,
) -> None:
    """Compare the camera's clock with the host's.

    \b
    Example:
      rig calibrate clock runs/first/run-1.mcap
    """
    from rig.calibrate import calibrate_clock

    _say(calibrate_clock(one_record(record), _filing(output, valid_days, by), counter_bits))


def shutter(record: Record, output: Folder = _FOLDER, valid_days: Days = _DAYS, by: By = "") -> None:
    """Measure the row time of a rolling shutter.

    From a run in which the spot swings across the rows.
    """
    from rig.calibrate import calibrate_shutter

    _say(calibrate_shutter(one_record(record), _filing(output, valid_days, by)))


def pointing(record: Record, output: Folder = _FOLDER, valid_days: Days = _DAYS, by: By = "") -> None:
    """Measure noise and drift of the spot, the pendulum clamped.

    \b
    Example:
      rig calibrate pointing clamped.mcap
    """
    from rig.calibrate import calibrate_pointing

    _say(calibrate_pointing(one_record(record), _filing(output, valid_days, by)))


def check(
    ladder: Ladder,
    lever: Annotated[
        Path, typer.Option(help="Calibration file of the lever to be checked.", show_default=False)
    ],
    output: Folder = _FOLDER,
    valid_days: Days = _DAYS,
    by: By = "",
) -> None:
    """Check the lever against known tilts.

    Before and after a series.

    \b
    Example:
      rig calibrate check tilts.toml --lever calibrations/lever-001.toml
    """
    from rig.calibrate import check_known_angle

    _say(check_known_angle(ladder, lever, _filing(output, valid_days, by)))


def _filing(folder: Path, valid_days: float, by: str) -> "Filing":
    from rig.calibrate import Filing

    return Filing(folder, valid_days, by)


def _say(path: Path) -> None:
    """Print the content of the new file."""
    from calibration import read_calibration

    found = read_calibration(path)
    print(f"{found.kind}: {found.method}, valid until {found.valid_until:%Y-%m-%d}")
    for name, value in {**found.values, **found.details}.items():
        if isinstance(value, bool | str):
            print(f"  {name:24} {value}")
        elif isinstance(value, int | float):
            print(f"  {name:24} {value:.6g}")
    for note in found.notes:
        print(f"note: {note}")
    print(path)
