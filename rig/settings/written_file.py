"""Files that `rig init` writes: a configuration of the answers, or a shipped configuration."""

import datetime
import textwrap
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic.fields import FieldInfo

from acquisition import atomic_write
from acquisition.cameras.drivers import DRIVERS
from calibration import toml_value
from processing.errors import ConfigurationError, RecordError
from rig.settings.configuration import Configuration
from rig.settings.configuration_file import SCHEMA, SCHEMA_KEY, load_configuration, read_toml, shipped
from rig.settings.validation_messages import section_fields, section_of

EXAMPLE_NAME = "my_steel"
"""Name in a table with names of the user's own, if none is stated."""


def commented_file(
    stated: Mapping[str, Any], *, without: Collection[str] = (), remarks: Mapping[str, str] | None = None
) -> str:
    """Text of a file with all sections and keys, each with its description.

    Parameters
    ----------
    stated
        Values by dotted key; every other key is commented out and shows its default.
    without
        Dotted names of sections that are left out, with their subsections.
    remarks
        Comments by dotted key, in place of the key's description.
    """
    return "\n".join(_section("", Configuration, stated, without, remarks or {})) + "\n"


def _section(
    path: str,
    model: type,
    stated: Mapping[str, Any],
    without: Collection[str],
    remarks: Mapping[str, str],
    *,
    listed: bool = False,
) -> Iterator[str]:
    if path:
        active = any(key.startswith(path) for key in stated)
        yield ""
        document = (model.__doc__ or "").strip().split("\n\n")[0]
        yield from (f"# {line}" for line in textwrap.wrap(" ".join(document.split()), 100))
        yield f"{'' if active else '# '}{f'[[{path[:-1]}]]' if listed else f'[{path[:-1]}]'}"
    fields = section_fields(model)
    for name, field in fields.items():
        if section_of(field) is None:
            yield _line(f"{path}{name}", field, stated, remarks)
    for name, field in fields.items():
        below = section_of(field)
        if below is None or f"{path}{name}" in without:
            continue
        for place in _places(f"{path}{name}.", field, stated):
            listed = str(field.annotation).startswith("tuple")
            yield from _section(place, below, stated, without, remarks, listed=listed)


def _places(path: str, field: FieldInfo, stated: Mapping[str, Any]) -> list[str]:
    """Paths of a section; one with names of the user's own has a path for each name."""
    if get_origin(field.annotation) is not dict:
        return [path]
    names = dict.fromkeys(key[len(path) :].partition(".")[0] for key in stated if key.startswith(path))
    return [f"{path}{name}." for name in names or (EXAMPLE_NAME,)]


def _line(key: str, field: FieldInfo, stated: Mapping[str, Any], remarks: Mapping[str, str]) -> str:
    if key in stated:
        value, lead = toml_value(stated[key]), ""
    else:
        lead = "# "
        default = field.get_default(call_default_factory=True)
        value = f"<{_kind(field)}>" if field.is_required() or default is None else toml_value(default)
    note = remarks.get(key, field.description)
    return f"{lead}{key.rpartition('.')[2]} = {value}{f'  # {note}' if note else ''}"


def _kind(field: FieldInfo) -> str:
    for kind in (field.annotation, *get_args(field.annotation)):
        if get_origin(kind) is Literal:
            return " or ".join(map(toml_value, get_args(kind)))
    text = str(field.annotation).removeprefix("<class '").removesuffix("'>").replace("AwareDatetime", "time")
    return text.split(".")[-1].replace(" | None", "")


Keys = Mapping[str, Any]
"""Values by dotted key."""


def _configuration_text(stated: Keys, made_at: datetime.datetime) -> str:
    """Text of the file: the stated values, and every other key of such a rig, commented out."""
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
    """Write the file and read it back; no file is left if that fails.

    Raises ConfigurationError for a file that exists already, or answers that contradict each other, and
    RecordError if it cannot be written.
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
    """Copy a shipped configuration, and those that it extends next to it; returns the files written.

    Extended files keep their names, which the copy states; existing files with the same text stay.

    Raises
    ------
    ConfigurationError
        There is no such configuration, or another file exists. Nothing is written then.
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
