"""Calibrations at the desk: what each kind needs, and what was filed."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from acquisition import atomic_write
from processing.errors import ConfigurationError, DataError, RecordError, RigError
from rig.prepare import CalibrationReport, next_free, read_calibration_report

if TYPE_CHECKING:
    from rig.desk.desk import Desk

FOLDER = Path("calibrations")
_UNKNOWN = "unknown"
_SIDES = (_UNKNOWN, "+", "-")


@dataclass(frozen=True)
class CalibrationKind:
    """One kind of calibration as a form over ``rig calibrate KIND``; `title` says what it measures."""

    title: str
    do: str
    """Instruction for a person at the rig."""
    list_text: str = ""
    """The list of measured values (TOML) to begin with; empty where the input is one record."""
    fields: Mapping[str, tuple[str, tuple[str, ...]]] = field(default_factory=dict)
    """Further options of the command by name: what is asked for, and the choices, if there are any."""


KINDS: Final[Mapping[str, CalibrationKind]] = {
    "lever": CalibrationKind(
        "Lever: from px to radians",
        "Measure both lengths with a tape or a rod; 1 mm in 1 m is 0.1 % of every angle. Or clamp the "
        'pendulum, set known tilts, and list them: kind = "tilt", then [[step]] for each.',
        "[geometry]\narm_m = 1.0\nu_arm_m = 0.001\npixel_pitch_m = 4.8e-6\nu_pixel_pitch_m = 1e-9\n",
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
        'darks = "records/sensor-001"\n\n[[level]]\nframes = "records/sensor-002"\nexposure_us = 50.0\n',
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
        '[[run]]\nrecord = "records/air-001.mcap"\narea_m2 = 0.0\n\n'
        '[[run]]\nrecord = "records/air-002.mcap"\narea_m2 = 0.067\n',
    ),
    "pointing": CalibrationKind(
        "Pointing: noise and drift of the spot",
        "Clamp the pendulum, close the cover, and let nobody walk around during the recording.",
    ),
    "check": CalibrationKind(
        "Check of the lever against known tilts",
        "Clamp the pendulum and set known tilts of both signs, before and after a series.",
        'kind = "tilt"\nunit = "arcsec"\npixel_pitch_m = 4.8e-6\nu_reference = 0.05\n\n'
        "[[step]]\nreference = -60.0\nx_px = 160.02\ny_px = 441.21\nu_px = 0.02\n",
        fields={"lever": ("calibration file of the lever to be checked", ())},
    ),
}
"""All kinds by the word after ``rig calibrate``, in the order in which a rig is calibrated."""


class Calibration:
    """A kind of calibration at a desk: `made` is what was filed here last, `problem` what went wrong last."""

    def __init__(self, desk: "Desk", name: str) -> None:
        self._desk = desk
        self.name, self.kind = name, KINDS[name]
        self.made: CalibrationReport | None = None
        self.problem = ""

    def file(self, given: str, stated: Mapping[str, str]) -> None:
        """Make the calibration by `rig calibrate` and file it; takes seconds.

        `given` is the name of a record, or the text of a list, which is first written to a file. The command
        judges what was `stated`, by the names of its options. Raises RigError where the measurement does not
        serve.
        """
        self.problem = ""
        try:
            path = _written(self.name, given) if self.kind.list_text else _record(given)
            words = [
                f"--{name}={text.strip()}"
                for name, text in {"output": str(FOLDER), **stated}.items()
                if text.strip() not in ("", _UNKNOWN)
            ]
            command = f"calibrate {self.name}"
            job = self._desk.jobs.begin(command, str(path), *words, "--json")
            job.wait()
            if job.status:
                raise RigError(job.problem)
            self.made = read_calibration_report(Path(job.lines[-1]["written"][0]))
        except RigError as error:
            self.problem = str(error)
            raise

    def use(self) -> str:
        """The calibration made last holds for all that this desk starts; returns what to state for good."""
        if self.made is None:
            raise ConfigurationError(f"no calibration of the {self.name} was made here yet")
        (table, keys), *_ = tomllib.loads(self.made.configuration).items()
        own = {f"{table}.{key}": _from_anywhere(stated) for key, stated in keys.items()}
        self._desk.checked(own)
        self._desk.kept.update(own)
        return self.made.configuration.replace("\n", "  ")


def _written(kind: str, text: str) -> Path:
    """The typed list as a new file; raises RecordError where it cannot be written."""
    path = next_free(FOLDER, f"{kind}-list", ".toml")
    try:
        FOLDER.mkdir(parents=True, exist_ok=True)
        atomic_write.write_new(path, text.encode())
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None
    return path


def _record(text: str) -> Path:
    path = Path(text.strip()).expanduser()
    if path.suffix != ".mcap" or not path.is_file():
        raise DataError(f"{text or 'record'}: there is no such record; name an MCAP file, or record one")
    return path


def _from_anywhere(stated: object) -> object:
    """Paths of this folder as they are found from any other."""
    if isinstance(stated, list):
        return [_from_anywhere(one) for one in stated]
    return Path(str(stated)).absolute().as_posix()
