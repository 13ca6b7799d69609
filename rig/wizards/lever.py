"""The wizard of the lever: lengths, or a ladder of known tilts or shifts, step by step."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from processing.errors import ConfigurationError
from rig.calibrate import LADDER_UNITS, Filing, LadderFile, calibrate_lever
from rig.settings import number, optional
from rig.wizards.calibration import a_record, write_table, yes_or_no
from rig.wizards.keys import KeysOf
from rig.wizards.question import Choice, Question, RecordedAnswer

_FEWEST_STEPS = 5
_SECONDS = 20.0
_KEYS = KeysOf(LadderFile)
_OTHERS = {
    "incidence_along_rad": "Angle of incidence on the mirror, from its normal, in the plane of the swing",
    "incidence_across_rad": "Angle of incidence across that plane",
    "sensor_tilt_along_rad": "Tilt of the sensor from perpendicular to the beam, in the plane of the swing",
    "sensor_tilt_across_rad": "Tilt of the sensor across that plane",
    "ball_radius_m": "Radius of the ball that rolls",
    "beam_height_m": "Height above the ball's centre at which the beam hits the mirror",
    "beam_reach_m": "Horizontal distance of the mirror in front of the ball's centre",
}


def lever_questions(values: Mapping[str, Any]) -> Iterator[Question]:
    """How it was measured, and then lengths or a ladder."""
    yield Question(
        "way",
        "How was it measured:",
        str,
        choices=(
            Choice("geometry", "from lengths, mirror to sensor and pixel pitch"),
            Choice("tilt", "known tilts of the clamped pendulum, by autocollimator, sine bar or level"),
            Choice("shift", "the sensor is moved by known lengths on a stage"),
        ),
    )
    yield from _geometry(values) if values["way"] == "geometry" else ladder_questions(values, values["way"])


def file_lever(values: Mapping[str, Any], filing: Filing) -> Path:
    """See `CalibrationWizard`."""
    stem = "lever-geometry" if values["way"] == "geometry" else "lever-ladder"
    return calibrate_lever(write_table(filing.folder, stem, lever_table(values)), filing)


def lever_table(values: Mapping[str, Any]) -> dict[str, Any]:
    """What the answers state, as the file has it."""
    if values["way"] == "geometry":
        stated = {
            key: value
            for found in values.values()
            if isinstance(found, Mapping)
            for key, value in found.items()
        }
        return {"geometry": {key.removeprefix("geometry."): value for key, value in stated.items()}}
    return ladder_table(values, values["way"])


def ladder_table(values: Mapping[str, Any], way: str) -> dict[str, Any]:
    """What the answers to `ladder_questions` state, as the file has it."""
    tree: dict[str, Any] = {"kind": way, "unit": values["unit"]}
    for name in ("scale", "setting", "factor"):
        tree |= values[name]
    if values.get("binning", 1) != 1:
        tree["binning"] = values["binning"]
    steps = []
    count = 1
    while values.get(f"reading {count}") is not None:
        steps.append({"reference": values[f"reading {count}"], **values[f"spot {count}"]})
        count += 1
    return tree | {"step": steps}


def _geometry(values: Mapping[str, Any]) -> Iterator[Question]:
    yield _KEYS.measured(
        "arm",
        "Mirror to sensor, along the beam at rest",
        "geometry.arm_m",
        "1 m ± 1 mm",
        do="Measure with a tape or a rod, and state the standard uncertainty after ±: 1 mm in 1 m is 0.1 % "
        "of every angle of every run.",
    )
    yield _KEYS.measured(
        "pitch", "Distance of neighbouring pixels of the sensor", "geometry.pixel_pitch_m", "4.8 um ± 1 nm"
    )
    yield Question(
        "square",
        "Does the beam meet mirror and sensor at right angles, within a degree or so?",
        yes_or_no,
        suggested="yes",
        choices=(Choice("yes", ""), Choice("no", "angles and places are asked")),
    )
    if values["square"]:
        return
    for name, text in _OTHERS.items():
        example = "1 deg ± 0.2 deg" if name.endswith("_rad") else "6.05 mm ± 1 mm"
        yield _KEYS.measured(name, text, f"geometry.{name}", example, suggested="0")


def ladder_questions(values: Mapping[str, Any], way: str) -> Iterator[Question]:
    """The questions of a ladder of known tilts or shifts (`way`)."""
    tilts = way == "tilt"
    yield Question(
        "unit",
        "Unit of the readings:",
        str,
        suggested="arcsec" if tilts else "mm",
        choices=tuple(Choice(unit, "") for unit in LADDER_UNITS[way]),
    )
    if tilts:
        yield Question(
            "scale",
            "Distance of neighbouring pixels of the sensor, in m (4.8 um):",
            _KEYS.alone("pixel_pitch_m"),
        )
    else:
        yield _KEYS.measured("scale", "Mirror to sensor, along the beam at rest", "arm_m", "1 m ± 1 mm")
    unit = values["unit"]
    yield Question(
        "setting",
        f"Standard uncertainty of one setting, in {unit}:",
        lambda text: _KEYS.checked({"u_reference": number(unit, least=0.0)(text)}),
    )
    yield Question(
        "factor",
        "Relative standard uncertainty of the scale of the reference (1e-3; from its certificate):",
        lambda text: _KEYS.checked({"u_reference_relative": number(least=0.0)(text)}),
        suggested="0",
    )
    do = (
        "Clamp the pendulum. Go from one end to the other through zero, and back: at least five settings, of "
        "both signs. Up and down again shows drift."
        if tilts
        else "Clamp the pendulum. Move the sensor along the swing, from one end to the other and back: at "
        "least five settings."
    )
    count, typed = 0, False
    while True:
        count += 1
        done = count > _FEWEST_STEPS
        yield Question(
            f"reading {count}",
            f"Step {count}: set it. Reading in {unit}{' (Enter: no further step)' if done else ''}:",
            optional(number(unit)) if done else number(unit),
            do=do if count == 1 else "",
            suggested="" if done else None,
            says_enter=done,
        )
        if values[f"reading {count}"] is None:
            break
        yield Question(
            f"spot {count}",
            "The spot there: x y u in px (160.02 441.21 0.02), or a record of the resting spot:",
            _spot,
            recording=RecordedAnswer("record", f"lever-step-{count}", seconds=_SECONDS),
        )
        typed = typed or "u_px" in values[f"spot {count}"]
    if typed:
        yield Question(
            "binning",
            "Binning of the picture with the typed spots (sensor pixels per picture pixel, each way):",
            lambda text: int(_KEYS.checked({"binning": int(number()(text))})["binning"]),
            suggested="1",
        )


def _spot(text: str) -> dict[str, Any]:
    words = text.replace(",", " ").split()
    if len(words) != 3 or Path(text).suffix == ".mcap":
        return {"record": a_record(text)}
    x_px, y_px, u_px = (number("px")(word) for word in words)
    if u_px <= 0:
        raise ConfigurationError(f"{text!r}: the uncertainty, the last number, should be greater than 0 px")
    return {"x_px": x_px, "y_px": y_px, "u_px": u_px}
