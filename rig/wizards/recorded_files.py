"""Questions of `rig init` about a film or a table in place of a camera, and what to do with the answers."""

from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from processing.angle import ARCSEC_RAD
from processing.errors import ConfigurationError
from rig.intake import film_needs_rate
from rig.settings import Configuration
from rig.wizards.draft import Draft
from rig.wizards.keys import Keys, KeysOf
from rig.wizards.question import Choice, Question

FILM, TABLE = "files", "table"
CHOICES = {
    FILM: "no camera: a film, raw pixels, or a folder of images, recorded before",
    TABLE: "no camera: a table of positions that another instrument measured",
}
_KEYS = KeysOf()
_ACROSS_RAD = 1.5707963267948966
_DIRECTIONS = {
    "up and down": Choice("up and down", "along the columns"),
    "left and right": Choice("left and right", "along the rows"),
}


def film_questions(values: Mapping[str, Any]) -> Iterator[Question]:
    """Which film; and the rate of frames that have no times of their own."""
    yield Question(
        "film",
        "The film, or folder of images:",
        lambda text: _KEYS.checked({"camera.files.path": _film(text), "camera.files.colour": "brightness"}),
        do="The film. It is read once, to see what it holds.",
    )
    if _needs_rate(values["film"]["camera.files.path"]):
        yield Question(
            "frame rate",
            "Frame rate of the images, in Hz:",
            _KEYS.alone("camera.files.frame_rate_hz"),
        )


def table_questions(values: Mapping[str, Any]) -> Iterator[Question]:
    """Which table."""
    yield Question("table", "The table (CSV, .xlsx, .npy, .mat):", _table, do="The table.")


def direction_question() -> Question:
    """Along what it swings in the film: nothing else says which direction is the slow one."""
    return Question(
        "direction",
        "The slow swing goes, in the picture:",
        lambda text: {} if text == "up and down" else _KEYS.checked({"axes.slow_angle_rad": _ACROSS_RAD}),
        suggested="up and down",
        choices=tuple(_DIRECTIONS.values()),
    )


def steps_of_file(file: Path, config: Configuration, answers: Draft) -> list[str]:
    """What to do with the configuration of a film or a table; none where there is a camera."""
    given = dict(answers.answers)
    if table := given.get("table"):
        return [
            f"rig fit {_quoted(table)} --unit arcsec --config {file} -o runs/{file.stem}: with its own unit"
        ]
    film = given.get("film")
    if film is None:
        return []
    rate = f" --rate {given['frame rate'].split()[0]}" if "frame rate" in given else ""
    command = f"rig video {_quoted(film)}{rate}"
    steps = [f"{command} -o runs/{file.stem}: period, damping and a report, in px"]
    lever = config.lever
    if lever is not None:
        # the mirror turns the beam by twice its own angle
        arcsec = lever.pixel_pitch_m / (2 * lever.arm_m) / ARCSEC_RAD
        scaled = f"{command} --pixel '{arcsec:.8g} arcsec'"
        of_laws = f" --config {file}" if config.pendulum is not None else ""
        what = "the laws of the contact, too" if of_laws else "the same, in arcsec"
        steps += [
            f"{scaled}{of_laws} -o runs/{file.stem}-arcsec: {what}",
            f"rig run {file} -o runs/{file.stem}-run: the film as a run of the rig",
        ]
    return steps


def _film(text: str) -> str:
    path = Path(text.strip("'\""))
    if not path.exists():
        raise ConfigurationError(f"{text}: no such file or folder here; name another")
    _needs_rate(path)
    return path.as_posix()


@lru_cache
def _needs_rate(path: str | Path) -> bool:
    """Kept, because every later question reads the answers before it again."""
    return film_needs_rate(Path(path))


def _table(text: str) -> Keys:
    path = Path(text.strip("'\""))
    if not path.is_file():
        raise ConfigurationError(f"{text}: no such file here; name another")
    return {}


def _quoted(name: str) -> str:
    bare = name.strip("'\"")
    return f"'{bare}'" if set(bare) & set(" ()&;'") else bare
