"""Wrong inputs, generated from the models of the configuration and from the parameters of the commands."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, get_args

import typer
from pydantic.fields import FieldInfo

from rig.cli import app
from rig.settings import Configuration
from rig.settings.validation_messages import section_fields, section_of

_MEANT = "tin"
_STATED = {"config", "file", "ladder", "frames", "lever", "configs", "vanes"}
"""Arguments that name what somebody has stated, in TOML: like a configuration, no record."""


class WrongKey(NamedTuple):
    """``KEY=VALUE`` pairs of --set that are wrong in one way, and the key that must be named."""

    kind: str
    overrides: tuple[str, ...]
    key: str


class WrongWords(NamedTuple):
    """The words of a command that is called in a wrong way, and its exit status."""

    kind: str
    words: tuple[str, ...]
    status: int


def wrong_keys() -> Iterator[WrongKey]:
    """Type, range, unit, unknown and doubled for every key; missing for every one without a default."""
    for key, field, whole in _keys("", Configuration):
        yield WrongKey("unknown", (f"{key}x=1",), f"{key}x")
        yield WrongKey("doubled", (f"{key}=1", f"{key}=1"), key)
        for value in _of_another_type(field):
            yield WrongKey("type", (f"{key}={value}",), key)
        for value in _out_of_range(field):
            yield WrongKey("range", (f"{key}={value:.17g}",), key)
        limits = [limit for name in ("lt", "le") if (limit := _limit(field, name)) is not None]
        if limits and isinstance(field.get_default(), int | float):
            # grams for kilograms, hPa for Pa: a thousand times too much
            yield WrongKey(
                "unit", (f"{key}={max(1000 * float(field.get_default()), 1.01 * limits[0]):g}",), key
            )
        if field.is_required() and whole and key != "camera.driver":
            section = key.rpartition(".")[0]
            stated = next((name for name in section_fields(whole) if f"{section}.{name}" != key), "")
            if stated:
                yield WrongKey("missing", (f"{section}.{stated}=1",), key)


def wrong_words(folder: Path) -> Iterator[WrongWords]:
    """Every parameter of every command: unknown, missing, of another type, out of range, unreadable."""
    (folder / "noise").write_bytes(bytes(range(256)))
    (folder / "empty").mkdir()
    for name, command in commands(typer.main.get_command(app)):
        arguments = [item for item in command.params if not item.opts[0].startswith("-")]
        needed = [item for item in command.params if item.required and item not in arguments]
        rest = [word for item in needed for word in (item.opts[0], "none/out.png")]
        given = ["x"] * sum(item.required for item in arguments)
        yield WrongWords("unknown", (*name, *given, *rest, "--nonsense"), 2)
        if given:
            yield WrongWords("missing", (*name, *rest), 2)
        for item in command.params:
            wanted = item.type_descriptor.annotation
            if item.name == "view":
                continue  # it may stand alone, before another argument
            if (
                item.opts[0].startswith("-")
                and (wanted in (int, float) or get_args(wanted))
                and wanted != list[str]
                and item.name != "of"  # folders that need not be there yet
            ):
                yield WrongWords("type", (*name, *given, *rest, item.opts[0], "many,3"), 2)
            if item.min is not None:
                yield WrongWords("range", (*name, *given, *rest, item.opts[0], f"{item.min - 1:g}"), 2)
        first = arguments[0] if arguments else None
        if first is not None and first.type_descriptor.annotation in (Path, list[Path], Path | None):
            more = given[1:]
            for file, status in (("none/x.mcap", 2), ("noise", _status_of_noise(name, first.name))):
                yield WrongWords("unreadable", (*name, file, *more, *rest), status)


def _status_of_noise(name: tuple[str, ...], argument: str | None) -> int:
    """Of a command that is given bytes: most begin to read them; some see before that nothing is in them, or
    that what they are to write has the name of a file.
    """
    return 2 if argument in _STATED or name in (("archive", "add"), ("export",)) else 1


def _keys(above: str, model: type) -> Iterator[tuple[str, FieldInfo, type | None]]:
    for name, field in section_fields(model).items():
        inner = section_of(field)
        if inner is None:
            yield f"{above}{name}", field, model if above else None
        elif "tuple" not in str(field.annotation):
            table = f"{name}.{_MEANT}" if str(field.annotation).startswith("dict") else name
            yield from _keys(f"{above}{table}.", inner)


def _of_another_type(field: FieldInfo) -> Iterator[str]:
    kinds = {field.annotation, *get_args(field.annotation)}
    if kinds & {int, float} and str not in kinds:
        yield from ("many", json.dumps("3"), "1,5", "nan")
        if bool not in kinds:
            yield "true"
    elif bool in kinds:
        yield "perhaps"
    elif str in kinds or Path in kinds:
        yield "[3]"


def _out_of_range(field: FieldInfo) -> Iterator[float]:
    for name, sign in (("gt", 0), ("ge", -1), ("lt", 0), ("le", 1)):
        limit = _limit(field, name)
        if limit is not None:
            yield limit + sign


def _limit(field: FieldInfo, name: str) -> float | None:
    return next((float(getattr(item, name)) for item in field.metadata if hasattr(item, name)), None)


def commands(group: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*above, name))
        else:
            yield (*above, name), command
