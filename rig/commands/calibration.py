"""Commands that calibrate: `rig calibrate lever`, `axes` and the others."""

import inspect
from collections.abc import Callable
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rig.commands.arguments import (
    Record,
    existing_toml,
    folder_without,
    group,
    in_json,
    input_argument,
    input_option,
    one_record,
    output_option,
)

if TYPE_CHECKING:
    from rig.prepare import Filing

_INPUT_FILE = "(TOML file); docs/calibrate.md shows one."
_LIST = existing_toml("docs/calibrate.md shows such a list")
Folder = Annotated[Path, output_option("Folder for the calibration file.", folder_without())]
Days = Annotated[
    float, typer.Option("--valid-days", help="Number of days for which the calibration is valid.")
]
By = Annotated[str, typer.Option("--by", help="Who made the calibration; default: the user's name.")]
Side = Annotated[
    Literal["+", "-"] | None,
    typer.Option(help="Sign of this mode's deflection in the first frame of the record."),
]
Calibrate = Callable[..., Path]
"""A function that makes a calibration from a file or record, a `Filing` and options of its own.

Its parameters stand in the order of the command's help; its docstring is that help.
"""


def lever(
    ladder: Annotated[Path, input_argument(f"Steps or geometry of the lever {_INPUT_FILE}", _LIST)],
    filing: "Filing",
) -> Path:
    """Calibrate pixels to radians.

    From geometry, known tilts or known shifts of the sensor.

    \b
    Example:
      rig calibrate lever geometry.toml
    """
    from rig.prepare import calibrate_lever

    return calibrate_lever(ladder, filing)


def axes(record: Record, filing: "Filing", slow_began: Side = None, fast_began: Side = None) -> Path:
    """Find the directions of both modes on the sensor.

    From a record in which both swing.

    \b
    Example:
      rig calibrate axes both-modes.mcap --slow-began +
    """
    from rig.prepare import calibrate_axes

    return calibrate_axes(one_record(record), filing, slow_began, fast_began)


def sensor(
    frames: Annotated[Path, input_argument(f"List of dark and evenly lit frames {_INPUT_FILE}", _LIST)],
    filing: "Filing",
) -> Path:
    """Measure the sensor: gain, read noise, dark level.

    By photon transfer.

    \b
    Example:
      rig calibrate sensor frames.toml
    """
    from rig.prepare import calibrate_sensor

    return calibrate_sensor(frames, filing)


def clock(
    record: Record,
    filing: "Filing",
    counter_bits: Annotated[
        int | None,
        typer.Option(
            help="Width in bits of the camera's nanosecond counter, if it rolls over.", min=16, max=62
        ),
    ] = None,
) -> Path:
    """Compare the camera's clock with the host's.

    \b
    Example:
      rig calibrate clock runs/first/run-1.mcap
    """
    from rig.prepare import calibrate_clock

    return calibrate_clock(one_record(record), filing, counter_bits)


def shutter(record: Record, filing: "Filing") -> Path:
    """Measure the row time of a rolling shutter.

    From a run in which the spot swings across the rows.
    """
    from rig.prepare import calibrate_shutter

    return calibrate_shutter(one_record(record), filing)


def air(
    vanes: Annotated[Path, input_argument(f"Runs with the areas of their vanes {_INPUT_FILE}", _LIST)],
    filing: "Filing",
) -> Path:
    """Measure the drag of the air.

    From runs with vanes of stated areas on the pendulum.

    \b
    Example:
      rig calibrate air vanes.toml
    """
    from rig.prepare import calibrate_air

    return calibrate_air(vanes, filing)


def pointing(record: Record, filing: "Filing") -> Path:
    """Measure noise and drift of the spot, the pendulum clamped.

    \b
    Example:
      rig calibrate pointing clamped.mcap
    """
    from rig.prepare import calibrate_pointing

    return calibrate_pointing(one_record(record), filing)


def check(
    ladder: Annotated[Path, input_argument(f"Known tilts {_INPUT_FILE}", _LIST)],
    *,
    lever: Annotated[
        Path,
        input_option(
            "Calibration file of the lever to be checked.",
            check=existing_toml("rig calibrate lever makes one"),
        ),
    ],
    filing: "Filing",
) -> Path:
    """Check the lever against known tilts.

    Before and after a series.

    \b
    Example:
      rig calibrate check tilts.toml --lever calibrations/lever-001.toml
    """
    from rig.prepare import check_known_angle

    return check_known_angle(ladder, lever, filing)


def _filing(output: Folder = Path("calibrations"), valid_days: Days = 90.0, by: By = "") -> "Filing":
    from rig.prepare import Filing

    return Filing(output, valid_days, by)


def _command(calibrate: Calibrate) -> Callable[..., None]:
    """The command of a calibration, whose options are those of `calibrate` and of `_filing`."""
    filing_parameters = inspect.signature(_filing).parameters

    def command(**kwargs: Any) -> None:
        filing = _filing(**{name: kwargs.pop(name) for name in filing_parameters})
        _print_calibration(calibrate(filing=filing, **kwargs))

    parameters: list[inspect.Parameter] = []
    for parameter in inspect.signature(calibrate).parameters.values():
        parameters += filing_parameters.values() if parameter.name == "filing" else [parameter]
    keywords = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in parameters]
    command.__name__, command.__doc__ = calibrate.__name__, calibrate.__doc__
    vars(command)["__signature__"] = inspect.Signature(keywords)
    return command


def _print_calibration(path: Path) -> None:
    """Print the content of the new file."""
    from rig.prepare import read_calibration_report, scalar_values
    from rig.terminal import answer, print_line, print_tables

    report = read_calibration_report(path)
    calibration = report.calibration
    answer(calibration=calibration.model_dump(mode="json"), written=[path])
    print_line(f"{calibration.kind}: {calibration.method}, valid until {calibration.valid_until:%Y-%m-%d}")
    scalars = scalar_values(calibration)
    undetermined = {
        name for name, value in scalars.items() if isinstance(value, float) and not isfinite(value)
    }
    for name, value in scalars.items():
        if {name, f"u_{name}"} & undetermined and not name.endswith("_dof"):
            print_line(f"  {name:24} not determined")
        elif isinstance(value, bool | str):
            print_line(f"  {name:24} {value}")
        else:
            print_line(f"  {name:24} {value:.6g}")
    print_tables([table for table in report.tables if table.name != "values"])
    for note in calibration.notes:
        print_line(f"note: {note}")
    print(path)


_CALIBRATIONS: tuple[Calibrate, ...] = (lever, axes, sensor, clock, shutter, air, pointing, check)
commands = group("calibrate", "Make a calibration file.", *map(in_json, map(_command, _CALIBRATIONS)))
