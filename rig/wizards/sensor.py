"""The wizard of the sensor: dark frames, and pairs of evenly lit ones at growing exposures."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from processing.errors import ConfigurationError
from rig.calibrate import Filing, TransferFile, calibrate_sensor
from rig.settings import number
from rig.wizards.calibration import first_positive, write_table
from rig.wizards.keys import KeysOf
from rig.wizards.question import Question, RecordedAnswer

_FEWEST_LEVELS = 5
_DARKS = 16


def sensor_questions(values: Mapping[str, Any], full_scale_dn: int | None) -> Iterator[Question]:
    """Dark frames and levels; `full_scale_dn` is suggested where the camera is known."""
    yield Question(
        "darks",
        "Dark frames, a folder of images, an .npy stack or a record:",
        _frames,
        do="Laser off, lamp off, lens cap on.",
        recording=RecordedAnswer("frames", "sensor-dark", frames=_DARKS),
    )
    yield Question(
        "full scale",
        "Largest value of a pixel, in DN (Enter: as the files say):",
        _full_scale,
        suggested="" if full_scale_dn is None else str(full_scale_dn),
        says_enter=True,
    )
    count = 0
    while True:
        count += 1
        done = count > _FEWEST_LEVELS
        yield Question(
            f"exposure {count}",
            f"Level {count}: exposure in us{' (Enter: no further level)' if done else ''}:",
            _exposure if not done else lambda text: _exposure(text) if text else None,
            do="Cap off. A lamp behind a diffuser, a metre away, steady; the laser stays off. Go from "
            "almost dark to almost saturated, each exposure half as long again as the one before."
            if count == 1
            else "",
            suggested="" if done else None,
            says_enter=done,
        )
        if values[f"exposure {count}"] is None:
            return
        yield Question(
            f"frames {count}",
            "Two frames or more of this level:",
            _frames,
            recording=RecordedAnswer(
                "frames", f"sensor-level-{count}", frames=2, exposure_us=values[f"exposure {count}"]
            ),
        )


def file_sensor(values: Mapping[str, Any], filing: Filing) -> Path:
    """See `CalibrationWizard`."""
    return calibrate_sensor(write_table(filing.folder, "sensor-frames", sensor_table(values)), filing)


def sensor_table(values: Mapping[str, Any]) -> dict[str, Any]:
    """What the answers state, as the file has it."""
    tree: dict[str, Any] = {"darks": values["darks"]}
    if values["full scale"] is not None:
        tree["full_scale_dn"] = values["full scale"]
    levels, count = [], 1
    while values.get(f"exposure {count}") is not None:
        levels.append({"frames": values[f"frames {count}"], "exposure_us": values[f"exposure {count}"]})
        count += 1
    return tree | {"level": levels}


_exposure = first_positive(number("us"), "an exposure")


def _frames(text: str) -> Path:
    path = Path(text).expanduser()
    if not path.exists():
        raise ConfigurationError(f"{text}: there is no such file or folder")
    return path


def _full_scale(text: str) -> int | None:
    if not text:
        return None
    stated = number()(text)
    value = int(stated) if stated.is_integer() else stated
    return int(KeysOf(TransferFile).checked({"full_scale_dn": value})["full_scale_dn"])
