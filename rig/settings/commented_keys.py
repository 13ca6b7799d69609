"""The configuration as a file that shows every key: what is stated as it is, the others commented out."""

import textwrap
from collections.abc import Collection, Iterator, Mapping
from typing import Any, Literal, get_args, get_origin

from pydantic.fields import FieldInfo

from calibration import toml_value
from rig.settings.configuration import Configuration
from rig.settings.wording import section_fields, section_of

EXAMPLE_NAME = "my_steel"
"""What a table with names of the user's own is called where none is stated."""


def commented_file(
    stated: Mapping[str, Any], *, without: Collection[str] = (), remarks: Mapping[str, str] | None = None
) -> str:
    """All sections with all keys, and what each of them is.

    Parameters
    ----------
    stated
        Values by dotted key; every other key is commented out and shows its default.
    without
        Dotted names of sections that are left out, with all below them.
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
    """Where a section stands; one with names of the user's own stands once for each name."""
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
