"""Files that `rig init` writes: a configuration made from the answers, or a shipped configuration."""

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

ValuesByKey = Mapping[str, Any]
"""Values by dotted key."""
EXAMPLE_NAME = "my_steel"
"""Name in a table with names of the user's own, if none is stated."""


def commented_file(
    values: ValuesByKey, *, omitted: Collection[str] = (), comments: Mapping[str, str] | None = None
) -> str:
    """Text of a file with all sections and keys, each with its description.

    Parameters
    ----------
    values
        Values of the keys; every other key is commented out and shows its default.
    omitted
        Dotted names of sections that are left out, with their subsections.
    comments
        Comments by dotted key, in place of the key's description.
    """
    return "\n".join(_section("", Configuration, values, omitted, comments or {})) + "\n"


def _section(
    path: str,
    model: type,
    values: ValuesByKey,
    omitted: Collection[str],
    comments: Mapping[str, str],
    *,
    listed: bool = False,
) -> Iterator[str]:
    if path:
        is_active = any(key.startswith(path) for key in values)
        yield ""
        description = (model.__doc__ or "").strip().split("\n\n")[0]
        yield from (f"# {line}" for line in textwrap.wrap(" ".join(description.split()), 100))
        yield f"{'' if is_active else '# '}{f'[[{path[:-1]}]]' if listed else f'[{path[:-1]}]'}"
    fields = section_fields(model)
    for name, field in fields.items():
        if section_of(field) is None:
            yield _line(f"{path}{name}", field, values, comments)
    for name, field in fields.items():
        section = section_of(field)
        if section is None or f"{path}{name}" in omitted:
            continue
        for section_path in _section_paths(f"{path}{name}.", field, values):
            listed = str(field.annotation).startswith("tuple")
            yield from _section(section_path, section, values, omitted, comments, listed=listed)


def _section_paths(path: str, field: FieldInfo, values: ValuesByKey) -> list[str]:
    """Paths of a section; one with names of the user's own has a path for each name."""
    if get_origin(field.annotation) is not dict:
        return [path]
    names = dict.fromkeys(key[len(path) :].partition(".")[0] for key in values if key.startswith(path))
    return [f"{path}{name}." for name in names or (EXAMPLE_NAME,)]


def _line(key: str, field: FieldInfo, values: ValuesByKey, comments: Mapping[str, str]) -> str:
    if key in values:
        value, prefix = toml_value(values[key]), ""
    else:
        prefix = "# "
        default = field.get_default(call_default_factory=True)
        value = f"<{_kind(field)}>" if field.is_required() or default is None else toml_value(default)
    comment = comments.get(key, field.description)
    return f"{prefix}{key.rpartition('.')[2]} = {value}{f'  # {comment}' if comment else ''}"


def _kind(field: FieldInfo) -> str:
    for kind in (field.annotation, *get_args(field.annotation)):
        if get_origin(kind) is Literal:
            return " or ".join(map(toml_value, get_args(kind)))
    text = str(field.annotation).removeprefix("<class '").removesuffix("'>").replace("AwareDatetime", "time")
    return text.split(".")[-1].replace(" | None", "")


def _configuration_text(values: ValuesByKey, now: datetime.datetime) -> str:
    """Text of the file: the stated values, and every other key of such a rig, commented out."""
    driver = values["camera.driver"]
    omitted = {f"camera.{name}" for name in DRIVERS if name != driver}
    if driver != "simulated":
        omitted |= {"simulation", "faults"}
    header = [
        f"# By rig init, {now:%Y-%m-%d %H:%M}. Your answers are stated; every other key of such",
        "# a rig is commented out with its value. Uncomment and change what you need.",
        "# A key that is misspelt, out of range or of the wrong type is an error, never ignored.",
        "# Values in angle brackets have no default. On the command line: --set session.runs=3",
    ]
    comments = {
        "balance.inertia_kg_m2": "about the contact, from the drawing; with the mass centre on the contact "
        "m g R T0^2/4 pi^2; if left out, the height is not computed"
    }
    if "camera.exposure_us" in values:
        comments["camera.exposure_us"] = "rig camera expose finds it"
    return (
        "\n".join([*header, f"{SCHEMA_KEY} = {SCHEMA}"])
        + "\n"
        + commented_file(values, omitted=omitted, comments=comments)
    )


def write_configuration(path: Path, values: ValuesByKey) -> Configuration:
    """Write the file and read it back; no file is left if that fails.

    Raises ConfigurationError for a file that exists already, or answers that contradict each other, and
    RecordError if it cannot be written.
    """
    refuse_existing(path)
    text = _configuration_text(values, datetime.datetime.now().astimezone())
    try:
        with atomic_write.atomic_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
            try:
                return load_configuration(temporary)
            except ConfigurationError as error:
                raise ConfigurationError(str(error).replace(str(temporary), str(path))) from None
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

    Extended files keep their names, which the copy states; existing files with the same text stay. Raises
    ConfigurationError, and writes nothing, for an unknown name or if another file exists, and RecordError if
    a file cannot be written.
    """
    texts, source, target = {}, shipped(name), path
    while True:
        texts[target] = source.read_bytes()
        base = read_toml(source, "configuration").get("extends")
        if base is None:
            break
        source, target = source.parent / base, path.parent / base
    new_texts = {target: text for target, text in texts.items() if not _has_text(target, text)}
    for target, text in new_texts.items():
        try:
            atomic_write.write_new(target, text)
        except OSError as error:
            raise RecordError(f"{target}: cannot be written: {error.strerror or error}") from None
    return list(new_texts)


def _has_text(path: Path, text: bytes) -> bool:
    """Whether a file exists with this text; raises ConfigurationError if it has another text."""
    if not path.exists():
        return False
    if path.is_file() and path.read_bytes() == text:
        return True
    raise ConfigurationError(f"{path}: exists already and is not overwritten; choose another folder or name")
