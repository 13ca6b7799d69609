"""Calibrations at the desk: what each kind needs, and what was filed."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from processing.errors import ConfigurationError, RigError
from rig.desk.desk import Desk
from rig.prepare import CalibrationReport, read_calibration_report

FOLDER = Path("calibrations")
_UNKNOWN = "unknown"
_SIDES = (_UNKNOWN, "+", "-")


@dataclass(frozen=True)
class CalibrationKind:
    """One kind of calibration as a form over ``rig calibrate KIND``; `title` says what it measures."""

    title: str
    do: str
    """Instruction for a person at the rig."""
    is_list: bool = False
    """Whether its input is a list of measured values (TOML file); else it is one record."""
    fields: Mapping[str, tuple[str, tuple[str, ...]]] = field(default_factory=dict)
    """Further options of the command by name: what is asked for, and the choices, if there are any."""


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


def file_calibration(desk: Desk, name: str, given: str, stated: Mapping[str, str]) -> CalibrationReport:
    """Make a calibration by `rig calibrate` and file it; takes seconds.

    The command judges `given`, its file or record, and what was `stated`, by the names of its options.
    Raises RigError where the measurement does not serve.
    """
    if not given.strip():
        raise ConfigurationError(f"rig calibrate {name}: name its file or record")
    words = [
        f"--{option}={text.strip()}"
        for option, text in {"output": str(FOLDER), **stated}.items()
        if text.strip() not in ("", _UNKNOWN)
    ]
    job = desk.jobs.begin(f"calibrate {name}", *words, "--json", "--", given.strip())
    job.wait()
    if job.status:
        raise RigError(job.problem)
    return read_calibration_report(Path(job.lines[-1]["written"][0]))


def use_calibration(desk: Desk, made: CalibrationReport) -> str:
    """Let a calibration hold for all that this desk starts; returns what to state for good."""
    (table, keys), *_ = tomllib.loads(made.configuration).items()
    own = {f"{table}.{key}": _from_anywhere(stated) for key, stated in keys.items()}
    desk.checked(own)
    desk.kept.update(own)
    return made.configuration.replace("\n", "  ")


def _from_anywhere(stated: object) -> object:
    """Paths of this folder as they are found from any other."""
    if isinstance(stated, list):
        return [_from_anywhere(one) for one in stated]
    return Path(str(stated)).absolute().as_posix()
