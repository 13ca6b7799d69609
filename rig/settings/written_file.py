"""Configuration files that `rig init` writes: from answers, or as they come with the program."""

import datetime
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from acquisition import atomic_write
from acquisition.cameras.drivers import DRIVERS
from processing.errors import ConfigurationError, RecordError
from rig.settings.commented_keys import commented_file
from rig.settings.configuration import Configuration
from rig.settings.configuration_file import SCHEMA, SCHEMA_KEY, load_configuration
from rig.settings.shipped_configurations import shipped
from rig.settings.toml_file import read_toml

Keys = Mapping[str, Any]
"""Values by dotted key."""


def _configuration_text(stated: Keys, made_at: datetime.datetime) -> str:
    """The file: what was stated, and every other key of such a rig, commented out."""
    driver = stated["camera.driver"]
    without = {f"camera.{name}" for name in DRIVERS if name != driver} | {"controller.faults"}
    if driver != "simulated":
        without |= {"simulation", "faults"}
    head = [
        f"# By rig init, {made_at:%Y-%m-%d %H:%M}. Your answers are stated; every other key of such",
        "# a rig is commented out with its value. Uncomment and change what you need.",
        "# A key that is misspelt, out of range or of the wrong type is an error, never ignored.",
        "# Values in angle brackets have no default. On the command line: --set session.runs=3",
    ]
    remarks = {
        "balance.inertia_kg_m2": "about the contact, from the drawing; with the mass centre on the contact "
        "m g R T0^2/4 pi^2; if left out, the height is not computed"
    }
    if "camera.exposure_us" in stated:
        remarks["camera.exposure_us"] = "rig camera expose finds it"
    return (
        "\n".join([*head, f"{SCHEMA_KEY} = {SCHEMA}"])
        + "\n"
        + commented_file(stated, without=without, remarks=remarks)
    )


def write_configuration(path: Path, stated: Keys) -> Configuration:
    """Write the file, and read it back; nothing is left where that fails.

    Raises ConfigurationError for a file that exists already, or answers that contradict each other, and
    RecordError where it cannot be written.
    """
    refuse_existing(path)
    text = _configuration_text(stated, datetime.datetime.now().astimezone())
    try:
        with atomic_write.being_written(path) as beside:
            beside.write_text(text, encoding="utf-8")
            try:
                return load_configuration(beside)
            except ConfigurationError as error:
                raise ConfigurationError(str(error).replace(str(beside), str(path))) from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be written: {error.strerror or error}") from None


def refuse_existing(path: Path) -> None:
    """Raise ConfigurationError for a file that exists, is no TOML file, or whose folder is missing."""
    if path.suffix != ".toml":
        raise ConfigurationError(f"{path}: a configuration is a TOML file; name one that ends in .toml")
    if path.exists():
        raise ConfigurationError(f"{path}: exists already and is not overwritten; choose another name")
    if not path.parent.is_dir():
        raise ConfigurationError(f"{path}: there is no folder {path.parent}")


def copy_shipped(name: str, path: Path) -> list[Path]:
    """Write one that comes with the program, and those that it extends beside it; returns the files written.

    What it extends keeps its name, which the file states; what lies there already with the same text stays.

    Raises
    ------
    ConfigurationError
        No such configuration, or a file is there that says something else. Nothing is written then.
    RecordError
        A file cannot be written.
    """
    texts, source = {}, shipped(name)
    target = path
    while True:
        texts[target] = source.read_bytes()
        base = read_toml(source, "configuration").get("extends")
        if base is None:
            break
        source, target = source.parent / base, path.parent / base
    missing = {target: text for target, text in texts.items() if not _holds(target, text)}
    for target, text in missing.items():
        try:
            atomic_write.write_new(target, text)
        except OSError as error:
            raise RecordError(f"{target}: cannot be written: {error.strerror or error}") from None
    return list(missing)


def _holds(path: Path, text: bytes) -> bool:
    if not path.exists():
        return False
    if path.is_file() and path.read_bytes() == text:
        return True
    raise ConfigurationError(f"{path}: exists already and is not overwritten; choose another folder or name")
