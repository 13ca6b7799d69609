"""Reads a TOML configuration into its models; every error is reported in a line of its own.

A file may begin with ``extends = "other.toml"`` (relative to itself) and then states only what
differs. On the command line ``--set a.b.c=value`` replaces any key by its dotted path.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from processing.errors import ConfigurationError, dotted_key, require_schema
from processing.units import unit_of_name
from rig.settings.configuration import Configuration
from rig.settings.number_input import quantity, states_unit
from rig.settings.validation_messages import KeyFault, validate

_TWICE_MESSAGES = ("Cannot overwrite a value", "Cannot declare", "Duplicate")


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """The tables of a TOML file, which may begin with a byte order mark; `what` is its kind in messages.

    Raises ConfigurationError with one line if the file is missing, a folder, unreadable or not TOML.
    """
    if path.suffix.lower() == ".mcap" or (path.is_dir() and any(path.glob("*.mcap"))):
        kind = "is a folder with records" if path.is_dir() else "is a record"
        raise ConfigurationError(f"{path}: {kind}, not a {what}; rig record info {path} says how it was made")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: cannot be read: no such {what}") from None
    except IsADirectoryError:
        raise ConfigurationError(f"{path}: is a folder; name a TOML file") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: is not TOML: it contains bytes that are not UTF-8 text") from None
    except ValueError as error:
        raise ConfigurationError(f"{str(path)!r}: is not the name of a file ({error})") from None
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ConfigurationError(f"{path}: is not TOML: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{path}: is not TOML: {error}{_hint(str(error), text)}") from None


def _hint(toml_error: str, text: str) -> str:
    """The likely meaning of a common error that TOML's message does not explain; else empty."""
    place = re.search(r"at line (\d+)", toml_error)
    line = text.splitlines()[int(place[1]) - 1] if place and int(place[1]) <= text.count("\n") + 1 else ""
    if toml_error.startswith(_TWICE_MESSAGES):
        return "; this is stated twice, as a section or with its name before a point: state it once"
    if number := re.match(r"\s*([\w.]+)\s*=\s*[+-]?\d[\d.eE+-]*\s+[^\W\d]", line):
        return f"; {number[1]} is a number alone, in the unit that its name ends with"
    if number := re.search(r"=\s*([+-]?\d+),(\d+)", line):
        return f"; a decimal point is meant: {number[1]}.{number[2]}"
    if re.fullmatch(r"\s*[\w.]+\s*=\s*[A-Za-z_].*", line):
        return "; put text in quotes"
    return ""


SCHEMA_KEY: Final = "schema"
SCHEMA: Final = 1


def load_configuration(
    path: Path, overrides: Iterable[str] = (), *, needs_camera: bool = True
) -> Configuration:
    """Read a configuration file and apply ``KEY=VALUE`` overrides.

    Without `needs_camera`, for calculations from a table, ``camera.driver`` may be left out.

    Raises ConfigurationError for a missing file, invalid TOML, unknown keys (naming the nearest known one),
    and values of the wrong type or out of range: a line for each, which names the file or --set.
    """
    tree = read_toml_tree(path)
    overrides = tuple(overrides)
    apply_overrides(tree, overrides)
    if not needs_camera and "camera" not in tree:
        tree["camera"] = {"driver": "files"}
    return validate_configuration(tree, str(path), overrides).remember_file(path, overrides)


def read_toml_tree(path: Path, visited: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Tables of a configuration file, merged over those of the file that it extends."""
    tree = read_toml(path, "configuration file; rig init writes one")
    if path.resolve() in visited:
        raise ConfigurationError(f"{path}: extends itself; remove one of the 'extends' lines")
    tree = unnumbered(tree, str(path))
    base = tree.pop("extends", None)
    if base is None:
        return tree
    if not isinstance(base, str):
        raise ConfigurationError(f"{path}: extends = {base!r} must be the name of a file")
    if not (path.parent / base).exists():
        raise ConfigurationError(
            f"{path}: extends = {base!r}: no such file in {path.parent.resolve()}, the folder of this one"
        )
    return _merge(read_toml_tree(path.parent / base, (*visited, path.resolve())), tree)


def unnumbered(tree: Mapping[str, Any], what: str) -> dict[str, Any]:
    """The tables of a configuration without the number of its schema, which a person may leave out.

    Raises ConfigurationError for the number of another version.
    """
    require_schema(what, tree.get(SCHEMA_KEY, SCHEMA), SCHEMA, ConfigurationError)
    return {key: value for key, value in tree.items() if key != SCHEMA_KEY}


def stored_configuration(config: Configuration) -> dict[str, Any]:
    """The whole configuration as it is stored in records and sessions, with the number of its schema."""
    return {SCHEMA_KEY: SCHEMA, **config.model_dump(mode="json")}


def validate_configuration(
    tree: Mapping[str, Any], source: str, overrides: Iterable[str] = ()
) -> Configuration:
    """Validate nested tables; raises ConfigurationError with a line for each fault, unknown keys first.

    A fault of a key that one of `overrides` states is reported as one of --set, any other as one of `source`.
    """
    # an empty section, so that the missing key in it is reported, not the section
    tree = {"camera": {}, **tree}
    config, found_faults = validate(Configuration, tree)
    if config is not None:
        return config
    overrides = {override.partition("=")[0].strip(): override for override in overrides}
    stated = {f"{key}." for key in overrides}
    with_u = stated | {".u_".join(key.rsplit(".", 2)[:2]) + "." for key in stated if key.count(".") > 1}
    lines = []
    for fault in found_faults:
        is_stated, place = _is_from_overrides(fault, with_u), fault.place
        siblings = [key.rstrip(".") for key in sorted(stated) if place and key.startswith(f"{place[0]}.")]
        why = f" (--set {siblings[0]} states this section)" if fault.is_missing and siblings else ""
        line = fault.line
        at = {text: line.find(key) for key, text in overrides.items()}
        # the line begins with another of the keys that contradict each other
        of_set = "" if place or 0 in at.values() else "".join(f"{text}: " for text in at if at[text] > 0)
        lines.append(f"{f'--set {of_set}' if is_stated else f'{source}: '}{fault.line}{why}")
    raise ConfigurationError("\n".join(lines))


def keys_with_faults(keys: Mapping[str, Any], whole: str = "") -> list[str]:
    """A line for each fault of values by dotted key; other keys may be missing.

    Relations between the keys of a section are checked only for the section `whole`.
    """
    tree: dict[str, Any] = {"camera": {"driver": "files"}}
    for key, value in keys.items():
        *sections, name = key.split(".")
        place = tree
        for section in sections:
            place = place.setdefault(section, {})
        place[name] = value
    _, found_faults = validate(Configuration, tree)
    asked = {*keys, whole} - {""}
    return [fault.line for fault in found_faults if dotted_key(fault.place) in asked]


def _is_from_overrides(fault: KeyFault, stated: set[str]) -> bool:
    """Whether a fault belongs to a key that --set states, or to a key above or below it.

    A fault between several keys has no place; its line names them.
    """
    if not fault.place:
        return any(key.rstrip(".") in fault.line for key in stated)
    place = dotted_key(fault.place)
    return any(key.startswith(f"{place}.") or f"{place}.".startswith(key) for key in stated)


def _merge(base: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    result = dict(base)
    for key, value in changes.items():
        inner = result.get(key)
        result[key] = _merge(inner, value) if isinstance(inner, dict) and isinstance(value, dict) else value
    return result


def apply_overrides(tree: dict[str, Any], overrides: Iterable[str]) -> None:
    """Set ``KEY=VALUE`` (dotted path, TOML value or bare word) in nested dictionaries, in place.

    A number may state its unit and its standard uncertainty: ``pendulum.ball_radius_m="6.05 mm ± 1 um"``.
    """
    stated = set()
    for override in overrides:
        key = override.partition("=")[0].strip()
        if key in stated:
            raise ConfigurationError(f"--set {override}: {key} is stated twice; leave one of them out")
        stated.add(key)
        _apply_override(tree, override)


def _apply_override(tree: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise ConfigurationError(f"--set {override}: must read KEY=VALUE, for example --set session.runs=3")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    parts = key.strip().split(".")
    place = tree
    for part in parts[:-1]:
        place = place.setdefault(part, {})
        if not isinstance(place, dict):
            raise ConfigurationError(f"--set {override}: {part} is a value, not a table")
    name = parts[-1]
    place[name] = value
    if isinstance(value, str) and states_unit(value) and (unit := unit_of_name(name)):
        try:
            place[name], u = quantity(value, unit)
        except ConfigurationError as error:
            raise ConfigurationError(f"--set {key.strip()} = {error}") from None
        if u is not None:
            place[f"u_{name}"] = u


def _folder() -> Path:
    package = Path(str(files("rig")))
    return next(folder for folder in (package / "configs", package.parent / "configs") if folder.is_dir())


def shipped_names() -> list[str]:
    """Names of the configurations that come with the program."""
    return sorted(path.stem for path in _folder().glob("*.toml"))


def shipped(name: str) -> Path:
    """The file of a configuration that comes with the program, ``basement`` for ``basement.toml``.

    Raises ConfigurationError with the known names for an unknown one.
    """
    if name not in (names := shipped_names()):
        raise ConfigurationError(
            f"example {name}: there is no such configuration; there are {', '.join(names)}"
        )
    return _folder() / f"{name}.toml"


ALL: Final = ("",)
FITTED: Final[Mapping[str, tuple[str, ...]]] = {
    **dict.fromkeys(("balance", "calibration", "environment", "fit", "instrument", "materials"), ALL),
    **dict.fromkeys(("pendulum", "preflight", "timebase"), ALL),
    "axes": ("u_",),
    "lever": ("u_", "arm_dof", "pixel_pitch_dof"),
    "reference": ("gain", "u_gain"),
    "seismometer": ("kind",),
    "session": ("contact_made", "surfaces_cleaned"),
    "shutter": ("u_",),
}
"""Beginnings of the keys that change what is fitted to recorded half-cycles, by section."""
REPLAYED: Final[Mapping[str, tuple[str, ...]]] = {
    **FITTED,
    **dict.fromkeys(("axes", "lever", "reference", "shutter"), ALL),
    "laser": ("pulse_",),
}
"""The same for half-cycles that are found again in recorded spots."""


def refuse_without_effect(
    overrides: Iterable[str], effective: Mapping[str, tuple[str, ...]], remedy: str
) -> None:
    """Raise ConfigurationError with a line for each changed key that begins as none `effective` does."""
    places = (override.partition("=")[0].strip().partition(".") for override in overrides)
    lines = [
        f"--set {section}{point}{name}: has no effect here; {remedy}"
        for section, point, name in places
        if not name.startswith(effective.get(section, ()))
    ]
    if lines:
        raise ConfigurationError("\n".join(lines))
