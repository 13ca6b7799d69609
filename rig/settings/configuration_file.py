"""Reads a TOML configuration into its models; reports every error in a line of its own.

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
from rig.settings.number_input import read_quantity, states_unit
from rig.settings.validation_messages import KeyFault, validate

_DUPLICATE_MESSAGES = ("Cannot overwrite a value", "Cannot declare", "Duplicate")


def read_toml(path: Path, kind: str) -> dict[str, Any]:
    """The tables of a TOML file, which may begin with a byte order mark; `kind` describes it in messages.

    Raises ConfigurationError with one line if the file is missing, a folder, unreadable or not TOML.
    """
    if path.suffix.lower() == ".mcap" or (path.is_dir() and any(path.glob("*.mcap"))):
        content = "is a folder with records" if path.is_dir() else "is a record"
        raise ConfigurationError(
            f"{path}: {content}, not a {kind}; rig record info {path} says how it was made"
        )
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: cannot be read: no such {kind}") from None
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
    number = re.search(r"at line (\d+)", toml_error)
    line = text.split("\n")[int(number[1]) - 1] if number else ""
    if toml_error.startswith(_DUPLICATE_MESSAGES):
        return "; this is stated twice, as a section or with its name before a point: state it once"
    if key := re.match(r"\s*([\w.]+)\s*=\s*[+-]?\d[\d.eE+-]*\s+[^\W\d]", line):
        return f"; {key[1]} is a number alone, in the unit that its name ends with"
    if decimal := re.search(r"=\s*([+-]?\d+),(\d+)", line):
        return f"; a decimal point is meant: {decimal[1]}.{decimal[2]}"
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
    tree = without_schema(tree, str(path))
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


def without_schema(tree: Mapping[str, Any], source: str) -> dict[str, Any]:
    """The tables without the number of their schema; raises ConfigurationError for another version."""
    require_schema(source, tree.get(SCHEMA_KEY, SCHEMA), SCHEMA, ConfigurationError)
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
    config, faults = validate(Configuration, tree)
    if config is not None:
        return config
    overrides = {override.partition("=")[0].strip(): override for override in overrides}
    set_keys = {f"{key}." for key in overrides}
    # a number with its standard uncertainty states the key `u_...` as well
    with_u = set_keys | {".u_".join(key.rsplit(".", 2)[:2]) + "." for key in set_keys if key.count(".") > 1}
    lines = []
    for fault in faults:
        is_stated, place, line = _is_from_overrides(fault, with_u), fault.place, fault.line
        siblings = [key.rstrip(".") for key in sorted(set_keys) if place and key.startswith(f"{place[0]}.")]
        hint = f" (--set {siblings[0]} states this section)" if fault.is_missing and siblings else ""
        positions = {text: line.find(key) for key, text in overrides.items()}
        # of keys that contradict each other, the line may begin with one that --set does not state
        is_first = place or 0 in positions.values()
        prefix = "" if is_first else "".join(f"{text}: " for text in positions if positions[text] > 0)
        lines.append(f"{f'--set {prefix}' if is_stated else f'{source}: '}{line}{hint}")
    raise ConfigurationError("\n".join(lines))


def key_faults(values: Mapping[str, Any], complete_section: str = "") -> list[str]:
    """A line for each fault of values by dotted key; other keys may be missing.

    Relations between the keys of a section are checked only for `complete_section`.
    """
    tree: dict[str, Any] = {"camera": {"driver": "files"}}
    for key, value in values.items():
        *sections, name = key.split(".")
        table = tree
        for section in sections:
            table = table.setdefault(section, {})
        table[name] = value
    _, faults = validate(Configuration, tree)
    checked = {*values, complete_section} - {""}
    return [fault.line for fault in faults if dotted_key(fault.place) in checked]


def _is_from_overrides(fault: KeyFault, set_keys: set[str]) -> bool:
    """Whether a fault belongs to a key that --set states, or to a key above or below it.

    A fault between several keys has no place; its line names them.
    """
    if not fault.place:
        return any(key.rstrip(".") in fault.line for key in set_keys)
    place = dotted_key(fault.place)
    return any(key.startswith(f"{place}.") or f"{place}.".startswith(key) for key in set_keys)


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
    set_keys = set()
    for override in overrides:
        key = override.partition("=")[0].strip()
        if key in set_keys:
            raise ConfigurationError(f"--set {override}: {key} is stated twice; leave one of them out")
        set_keys.add(key)
        _apply_override(tree, override)


def _apply_override(tree: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    if not equals or not key.strip():
        raise ConfigurationError(f"--set {override}: must read KEY=VALUE, for example --set session.runs=3")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    *sections, name = key.strip().split(".")
    table = tree
    for section in sections:
        table = table.setdefault(section, {})
        if not isinstance(table, dict):
            raise ConfigurationError(f"--set {override}: {section} is a value, not a table")
    table[name] = value
    if isinstance(value, str) and states_unit(value) and (unit := unit_of_name(name)):
        try:
            table[name], u = read_quantity(value, unit)
        except ConfigurationError as error:
            raise ConfigurationError(f"--set {key.strip()} = {error}") from None
        if u is not None:
            table[f"u_{name}"] = u


def _shipped_folder() -> Path:
    package = Path(str(files("rig")))
    return next(folder for folder in (package / "configs", package.parent / "configs") if folder.is_dir())


def shipped_names() -> list[str]:
    """Names of the configurations that come with the program."""
    return sorted(path.stem for path in _shipped_folder().glob("*.toml"))


def shipped(name: str) -> Path:
    """The file of a configuration of the program; raises ConfigurationError for an unknown name."""
    if name not in (names := shipped_names()):
        raise ConfigurationError(
            f"example {name}: there is no such configuration; there are {', '.join(names)}"
        )
    return _shipped_folder() / f"{name}.toml"


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
"""Beginnings of the keys that change which half-cycles a replay detects in recorded spots, by section."""


def refuse_without_effect(
    overrides: Iterable[str], effective: Mapping[str, tuple[str, ...]], remedy: str
) -> None:
    """Raise ConfigurationError with a line for each override whose key has no beginning of `effective`."""
    keys = (override.partition("=")[0].strip().partition(".") for override in overrides)
    lines = [
        f"--set {section}{point}{name}: has no effect here; {remedy}"
        for section, point, name in keys
        if not name.startswith(effective.get(section, ()))
    ]
    if lines:
        raise ConfigurationError("\n".join(lines))
