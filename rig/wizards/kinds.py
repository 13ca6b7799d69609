"""The wizard of each kind of calibration: those of one record, of the check of a lever, and the others."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from calibration import read_calibration
from processing.errors import ConfigurationError
from rig.calibrate import (
    Filing,
    VanesToCut,
    calibrate_axes,
    calibrate_clock,
    calibrate_pointing,
    calibrate_shutter,
    check_known_angle,
    vanes_to_cut,
)
from rig.settings import Configuration, number
from rig.wizards.air import air_questions, file_air
from rig.wizards.calibration import CalibrationWizard, a_record, write_table
from rig.wizards.lever import file_lever, ladder_questions, ladder_table, lever_questions
from rig.wizards.question import Choice, Question, RecordedAnswer
from rig.wizards.sensor import file_sensor, sensor_questions

Values = Mapping[str, Any]
KINDS = ("lever", "axes", "sensor", "clock", "shutter", "air", "pointing", "check")


def calibration_wizard(kind: str, config: Configuration | None = None) -> CalibrationWizard:
    """The wizard of one of `KINDS`; `config` is that of the rig, where one is at hand."""
    wizards: dict[
        str, tuple[str, Callable[[Values], Iterator[Question]], Callable[[Values, Filing], Path]]
    ] = {
        "lever": ("Calibration of the lever, from px to radians", lever_questions, file_lever),
        "axes": (
            "Calibration of the axes: directions of both modes on the sensor",
            _axes,
            _of_record(calibrate_axes, "slow_began", "fast_began"),
        ),
        "sensor": (
            "Calibration of the sensor: gain, read noise, dark level",
            partial(sensor_questions, full_scale_dn=_full_scale_dn(config)),
            file_sensor,
        ),
        "clock": (
            "Calibration of the camera's clock against the computer's",
            _clock,
            _of_record(calibrate_clock, "counter_bits"),
        ),
        "shutter": (
            "Calibration of a rolling shutter: the time from row to row",
            _shutter,
            _of_record(calibrate_shutter),
        ),
        "air": (
            "Drag of the air, by vanes on the pendulum or at several pressures",
            partial(air_questions, vanes=_vanes(config)),
            file_air,
        ),
        "pointing": (
            "Noise and drift of the spot, the pendulum clamped",
            _pointing,
            _of_record(calibrate_pointing),
        ),
        "check": (
            "Check of the lever against known tilts",
            partial(_check, lever=None if config is None else config.calibration.lever),
            _file_check,
        ),
    }
    if kind not in wizards:
        raise ConfigurationError(f"{kind!r}: no such calibration; there are {', '.join(KINDS)}")
    return CalibrationWizard(kind, *wizards[kind])


def _of_record(calibrate: Callable[..., Path], *names: str) -> Callable[[Values, Filing], Path]:
    """Calibrates with a record, and with the answers to the questions of these names."""
    return lambda values, filing: calibrate(values["record"], filing, *(values[name] for name in names))


def _record(kind: str, seconds: float, do: str) -> Question:
    wanted = RecordedAnswer("record", kind, seconds=seconds)
    return Question("record", "The record:", a_record, do=do, recording=wanted)


def _axes(_: Values) -> Iterator[Question]:
    yield _record(
        "axes",
        60.0,
        "Decide which end and which side of the pendulum, moving down, count as positive. Push it gently in "
        "both directions, so that both modes swing, remember to which sides, and record from then on.",
    )
    for mode, assumed in (("slow", "up on the sensor is assumed"), ("fast", "to the right")):
        yield Question(
            f"{mode}_began",
            f"Sign of the {mode} mode's tilt in the first frame:",
            lambda text: None if text == "unknown" else text,
            suggested="unknown",
            choices=(
                Choice("+", "to the positive side"),
                Choice("-", "to the other side"),
                Choice("unknown", assumed),
            ),
        )


def _clock(_: Values) -> Iterator[Question]:
    yield _record(
        "clock", 1800.0, "Any long run of a real camera will do; half an hour gives a few parts in 10⁷."
    )
    yield Question(
        "counter_bits",
        "Width in bits of the camera's nanosecond counter, if it rolls over (Enter: it does not):",
        _bits,
        suggested="",
        says_enter=True,
    )


def _bits(text: str) -> int | None:
    if not text:
        return None
    value = number()(text)
    if not (value.is_integer() and 16 <= value <= 62):
        raise ConfigurationError(f"{text!r}: should be a whole number from 16 to 62")
    return int(value)


def _shutter(_: Values) -> Iterator[Question]:
    yield _record(
        "shutter",
        120.0,
        "Let the spot swing across the rows by a large part of the picture, with [shutter] left out of "
        "the configuration.",
    )


def _pointing(_: Values) -> Iterator[Question]:
    yield _record(
        "pointing",
        120.0,
        "Clamp the pendulum, close the cover, and let nobody walk around during the recording.",
    )


def _check(values: Values, lever: Path | None) -> Iterator[Question]:
    """The lever in use is suggested, where a configuration is at hand."""
    yield Question(
        "lever",
        "Calibration file of the lever to be checked:",
        _lever_file,
        suggested=None if lever is None else str(lever),
    )
    yield from ladder_questions(values, "tilt")


def _lever_file(text: str) -> Path:
    path = Path(text).expanduser()
    read_calibration(path, "lever")
    return path


def _file_check(values: Values, filing: Filing) -> Path:
    ladder = write_table(filing.folder, "check-ladder", ladder_table(values, "tilt"))
    return check_known_angle(ladder, values["lever"], filing)


def _vanes(config: Configuration | None) -> VanesToCut | None:
    """For the period of [simulation], which stands for what a rig does not know before its first run."""
    return None if config is None else vanes_to_cut(config, config.simulation.contact.period0_s)


def _full_scale_dn(config: Configuration | None) -> int | None:
    """Of the pixel format that is asked of the camera; its images may be stored with more bits."""
    stated = None if config is None else config.camera.pixel_format
    return None if stated is None else 2 ** int(stated.removeprefix("mono")) - 1
