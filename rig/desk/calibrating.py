"""Calibrations at the desk: the form of each kind, making a calibration file, and using it."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from processing.errors import ConfigurationError, RigError
from rig.desk.desk import Desk
from rig.prepare import CalibrationReport, read_calibration_report

_FOLDER = Path("calibrations")
_UNKNOWN = "unknown"
_SIDES = (_UNKNOWN, "+", "-")


@dataclass(frozen=True)
class CalibrationKind:
    """One kind of calibration as a form over ``rig calibrate KIND``."""

    title: str
    instruction: str
    """What a person has to do at the rig."""
    is_list: bool = False
    """Whether its input is a list of measured values (TOML file); else it is one record."""
    fields: Mapping[str, tuple[str, tuple[str, ...]]] = field(default_factory=dict)
    """Further options of the command by name: label of the field, and the choices, if there are any."""


KINDS: Final[Mapping[str, CalibrationKind]] = {
    "lever": CalibrationKind(
        "Lever: from px to radians",
        "Measure both lengths with a tape or a rod; 1 mm in 1 m is 0.1 % of every angle. Or clamp the "
        'pendulum, set known tilts, and list them: kind = "tilt", then [[step]] for each.',
        is_list=True,
    ),
    "axes": CalibrationKind(
        "Axes: directions of both modes on the sensor",
        "Decide which end and which side of the pendulum, moving down, count as positive. Push it gently "
        "in both directions, so that both modes swing, remember to which sides, and record from then on.",
        fields={
            "slow-began": ("sign of the slow mode's tilt in the first frame", _SIDES),
            "fast-began": ("sign of the fast mode's tilt in the first frame", _SIDES),
        },
    ),
    "sensor": CalibrationKind(
        "Sensor: gain, read noise, dark level",
        "Laser off, lamp off, lens cap on: record dark frames (rig camera frames). Then cap off, a lamp "
        "behind a diffuser, a metre away, and two frames or more at each of five exposures or more, from "
        "almost dark to almost saturated.",
        is_list=True,
    ),
    "clock": CalibrationKind(
        "Clock: the camera's against the computer's",
        "Any long run of a real camera will do; half an hour gives a few parts in 10⁷.",
        fields={"counter-bits": ("width of the camera's nanosecond counter, if it rolls over", ())},
    ),
    "shutter": CalibrationKind(
        "Rolling shutter: the time from row to row",
        "Let the spot swing across the rows by a large part of the picture, without [shutter] in the "
        "configuration.",
    ),
    "air": CalibrationKind(
        "Drag of the air: vanes on the pendulum",
        "Make two runs without vanes, two with the smaller and two with the larger ones, in turn, from "
        "one start, without lifting the ball off its place.",
        is_list=True,
    ),
    "pointing": CalibrationKind(
        "Pointing: noise and drift of the spot",
        "Clamp the pendulum, close the cover, and let nobody walk around during the recording.",
    ),
    "check": CalibrationKind(
        "Check of the lever against known tilts",
        "Clamp the pendulum and set known tilts of both signs, before and after a series.",
        is_list=True,
        fields={"lever": ("calibration file of the lever to be checked", ())},
    ),
}
"""All kinds by the word after ``rig calibrate``, in the order in which a rig is calibrated."""


def file_calibration(desk: Desk, name: str, source: str, options: Mapping[str, str]) -> CalibrationReport:
    """Make a calibration file by `rig calibrate` from `source`, a file or record; takes seconds.

    Raises RigError, with the command's reason, if the source or an option is refused.
    """
    if not source.strip():
        raise ConfigurationError(f"rig calibrate {name}: name its file or record")
    arguments = [
        f"--{option}={text.strip()}"
        for option, text in {"output": str(_FOLDER), **options}.items()
        if text.strip() not in ("", _UNKNOWN)
    ]
    job = desk.jobs.begin(f"calibrate {name}", *arguments, "--json", "--", source.strip())
    job.wait()
    if job.status:
        raise RigError(job.problem)
    return read_calibration_report(Path(job.lines[-1]["written"][0]))


def use_calibration(desk: Desk, report: CalibrationReport) -> str:
    """Use a calibration for all that this desk starts; returns its lines for the configuration file."""
    (table, keys), *_ = tomllib.loads(report.configuration).items()
    own = {f"{table}.{key}": _absolute(paths) for key, paths in keys.items()}
    desk.checked(own)
    desk.own_settings.update(own)
    return report.configuration.replace("\n", "  ")


def _absolute(paths: object) -> object:
    """A path, or a list of paths, made absolute."""
    if isinstance(paths, list):
        return [_absolute(path) for path in paths]
    return Path(str(paths)).absolute().as_posix()
