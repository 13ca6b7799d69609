"""The wizards of axes, clock, shutter and pointing: one record, and what no record can say."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from processing.errors import ConfigurationError
from rig.calibrate import Filing, calibrate_axes, calibrate_clock, calibrate_pointing, calibrate_shutter
from rig.settings import number
from rig.wizards.calibration import a_record
from rig.wizards.question import Choice, Question, RecordedAnswer


@dataclass(frozen=True)
class AxesWizard:
    """`rig calibrate axes`, asked."""

    kind: str = "axes"
    title: str = "Calibration of the axes: directions of both modes on the sensor"

    def questions(self, values: Mapping[str, Any]) -> Iterator[Question]:
        """See `Wizard`."""
        yield _record(
            self.kind,
            60.0,
            "Decide which end of the pendulum going down, and which side of it, shall be positive. Push it "
            "gently in both directions, so that both modes swing, remember to which sides, and "
            "record from then on.",
        )
        for mode in ("slow", "fast"):
            yield Question(
                f"{mode}_began",
                f"Sign of the {mode} mode's tilt in the first frame:",
                lambda text: None if text == "unknown" else text,
                suggested="unknown",
                choices=(
                    Choice("+", "to the positive side"),
                    Choice("-", "to the other side"),
                    Choice("unknown", "up on the sensor is assumed" if mode == "slow" else "to the right"),
                ),
            )

    def file(self, values: Mapping[str, Any], filing: Filing) -> Path:
        """See `CalibrationWizard`."""
        return calibrate_axes(values["record"], filing, values["slow_began"], values["fast_began"])


@dataclass(frozen=True)
class ClockWizard:
    """`rig calibrate clock`, asked."""

    kind: str = "clock"
    title: str = "Calibration of the camera's clock against the computer's"

    def questions(self, values: Mapping[str, Any]) -> Iterator[Question]:
        """See `Wizard`."""
        yield _record(
            self.kind, 1800.0, "Any long run of a real camera serves; half an hour gives some parts in 10⁷."
        )
        yield Question(
            "counter_bits",
            "Width in bits of the camera's nanosecond counter, if it rolls over (Enter: it does not):",
            _bits,
            suggested="",
            says_enter=True,
        )

    def file(self, values: Mapping[str, Any], filing: Filing) -> Path:
        """See `CalibrationWizard`."""
        return calibrate_clock(values["record"], filing, values["counter_bits"])


@dataclass(frozen=True)
class ShutterWizard:
    """`rig calibrate shutter`, asked."""

    kind: str = "shutter"
    title: str = "Calibration of a rolling shutter: the time from row to row"

    def questions(self, values: Mapping[str, Any]) -> Iterator[Question]:
        """See `Wizard`."""
        yield _record(
            self.kind,
            120.0,
            "Let the spot swing across the rows by a large part of the picture, with [shutter] left out of "
            "the configuration.",
        )

    def file(self, values: Mapping[str, Any], filing: Filing) -> Path:
        """See `CalibrationWizard`."""
        return calibrate_shutter(values["record"], filing)


@dataclass(frozen=True)
class PointingWizard:
    """`rig calibrate pointing`, asked."""

    kind: str = "pointing"
    title: str = "Noise and drift of the spot, the pendulum clamped"

    def questions(self, values: Mapping[str, Any]) -> Iterator[Question]:
        """See `Wizard`."""
        yield _record(
            self.kind, 120.0, "Clamp the pendulum, close the cover, and let nobody walk about meanwhile."
        )

    def file(self, values: Mapping[str, Any], filing: Filing) -> Path:
        """See `CalibrationWizard`."""
        return calibrate_pointing(values["record"], filing)


def _record(kind: str, seconds: float, do: str) -> Question:
    return Question(
        "record", "The record:", a_record, do=do, recording=RecordedAnswer("record", kind, seconds=seconds)
    )


def _bits(text: str) -> int | None:
    if not text:
        return None
    value = number()(text)
    if not (value.is_integer() and 16 <= value <= 62):
        raise ConfigurationError(f"{text!r}: should be a whole number from 16 to 62")
    return int(value)
