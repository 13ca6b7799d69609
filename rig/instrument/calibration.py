"""Calibration files: the sections that they fill, their attachments in records, and their validity."""

import datetime
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration import CalibrationFile, Kind, Lever, moved_between, parse_calibration
from processing.errors import ConfigurationError
from rig.settings import Configuration, FitSettings, validate_configuration
from rig.terminal import percent, signed_percent

PREFIX = "calibration/"
_SECTIONS: Mapping[Kind, str] = {
    "sensor": "sensor",
    "lever": "lever",
    "axes": "axes",
    "clock": "timebase",
    "shutter": "shutter",
}
"""Section of the configuration that a kind of file fills."""
_KINDS_WITHOUT_SECTION: tuple[Kind, ...] = ("air", "pointing")


def fill_from_files(config: Configuration) -> Configuration:
    """The configuration with the sections given by its calibration files.

    Raises ConfigurationError for a file that is missing, of another kind or not a calibration, and for a
    section that is also stated, with different values. An expired file is used, and the results report it.
    """
    updates: dict[str, Any] = {}
    for kind, section in _SECTIONS.items():
        path: Path | None = getattr(config.calibration, kind)
        if path is None:
            continue
        file = parse_calibration(_read(path, kind), str(path), kind)
        section_tree = {**file.values}
        if kind == "sensor" and (hot_pixels := file.details.get("hot_pixels_xy")):
            section_tree["hot_pixels_xy"] = hot_pixels
        tree = {"camera": {"driver": config.camera.driver}, section: section_tree}
        values = getattr(validate_configuration(tree, str(path)), section)
        if isinstance(values, Lever):
            values = values.with_binning(config.camera.pitch_factor)
        given_values = getattr(config, section)
        if given_values not in (None, values):
            raise ConfigurationError(
                f"[{section}] differs from the values in calibration.{kind} = {str(path)!r}; "
                "leave one of them out"
            )
        updates[section] = values
    air_path = config.calibration.air
    if air_path is not None:
        file = parse_calibration(_read(air_path, "air"), str(air_path), "air")
        # a stated "open" or "vacuum" takes precedence over the file
        if config.fit.drag == "air":
            updates["fit"] = _with_measured_drag(config, file, air_path)
    if config.calibration.pointing is not None:
        parse_calibration(_read(config.calibration.pointing, "pointing"), str(config.calibration.pointing))
    for path in config.calibration.checks:
        parse_calibration(_read(path, "checks"), str(path))
    return config.model_copy(update=updates)


def _with_measured_drag(config: Configuration, file: CalibrationFile, path: Path) -> FitSettings:
    """Fit settings with the drag of a calibration; raises ConfigurationError if another is stated."""
    settings = config.fit
    tree = {"camera": {"driver": config.camera.driver}, "fit": settings.model_dump() | file.values}
    new_settings = validate_configuration(tree, str(path)).fit
    if settings.drag_s is not None and settings != new_settings:
        raise ConfigurationError(
            f"fit.drag_s = {settings.drag_s:g} differs from the values in calibration.air = {str(path)!r}; "
            "leave one of them out"
        )
    return new_settings


def calibration_attachments(config: Configuration) -> dict[str, bytes]:
    """Contents of the calibration files in use, by attachment name."""
    paths = {kind: getattr(config.calibration, kind) for kind in (*_SECTIONS, *_KINDS_WITHOUT_SECTION)}
    contents = {f"{PREFIX}{kind}.toml": _read(path) for kind, path in paths.items() if path is not None}
    for number, path in enumerate(config.calibration.checks, 1):
        contents[f"{PREFIX}check-{number}.toml"] = _read(path)
    return contents


def judge_calibration(
    config: Configuration, attachments: Mapping[str, bytes], start: datetime.datetime, end: datetime.datetime
) -> tuple[dict[str, Any], list[str]]:
    """The calibration part of a run's results, and warnings.

    Parameters
    ----------
    config, attachments
        Those of the record. Checks named in `config` but missing in the record are read from their files,
        because a check after a series is made when its records are already closed.
    start, end
        Begin and end of the run.
    """
    tree: dict[str, Any] = {}
    warnings: list[str] = []
    missing = []
    for kind in (*_SECTIONS, *_KINDS_WITHOUT_SECTION):
        data = attachments.get(f"{PREFIX}{kind}.toml")
        if data is not None:
            file = parse_calibration(data, f"{PREFIX}{kind}.toml", kind)
            tree[kind] = _result_entry(file, data, start)
            if file.expired(start):
                days = (start - file.measured_at).total_seconds() / 86400
                warnings.append(
                    f"the calibration of the {kind} had expired on {file.valid_until:%Y-%m-%d}: "
                    f"it was measured on {file.measured_at:%Y-%m-%d}, {days:.0f} d before the run"
                )
        elif kind in _KINDS_WITHOUT_SECTION or (kind == "shutter" and config.shutter is None):
            continue  # a global shutter needs no calibration
        elif config.simulated:
            text = "true values of the simulated rig, or stated in the configuration"
            tree[kind] = {"validity": "simulated", "text": text}
        elif getattr(config, _SECTIONS[kind]) is not None:
            text = "stated in the configuration, without a calibration file"
            tree[kind] = {"validity": "stated", "text": text}
        else:
            tree[kind] = {"validity": "missing", "text": "no calibration"}
            missing.append(kind)
    if missing:
        warnings.append(f"not calibrated: {', '.join(missing)} (rig calibrate)")
    checks, lines = _angle_checks(config, attachments, start, end)
    if checks:
        tree["checks"] = checks
    return tree, [*warnings, *lines]


def _result_entry(file: CalibrationFile, data: bytes, time: datetime.datetime) -> dict[str, Any]:
    return {
        "validity": "expired" if file.expired(time) else "valid",
        "text": f"{file.method}; by {file.made_by or '?'}, valid until {file.valid_until:%Y-%m-%d}",
        "sha256": hashlib.sha256(data).hexdigest(),
        **file.model_dump(mode="json", exclude={"details", "schema_version"}),
    }


def _angle_checks(
    config: Configuration, attachments: Mapping[str, bytes], start: datetime.datetime, end: datetime.datetime
) -> tuple[list[dict[str, Any]], list[str]]:
    """Known-angle checks in order of time, and warnings of a lever's scale that is wrong or has changed."""
    paths = config.calibration.checks
    contents = [data for name, data in sorted(attachments.items()) if name.startswith(f"{PREFIX}check-")]
    contents += [_read(path) for path in paths if path.is_file()]
    checks = [(parse_calibration(data, "check", "check"), data) for data in dict.fromkeys(contents)]
    checks.sort(key=lambda item: item[0].measured_at)
    warnings = []
    missing = [str(path) for path in paths if not path.is_file()]
    if missing and len(checks) < len(set(paths)):
        warnings.append(f"known-angle checks that could not be read: {', '.join(missing)}")
    for check, _ in checks:
        if check.details.get("moved"):
            ratio, u = check.details["ratio"], check.details["u_both"]
            warnings.append(
                f"known angles on {check.measured_at:%Y-%m-%d %H:%M}: the lever's scale is off by "
                f"{signed_percent(ratio - 1, 3)} (u = {percent(u)})"
            )
    earlier = [check for check, _ in checks if check.measured_at <= start]
    later = [check for check, _ in checks if check.measured_at >= end]
    if earlier and later:
        first, last = earlier[-1].details, later[0].details
        change, u_change, moved = moved_between(
            (first["ratio"], first["u_ratio"]),
            (last["ratio"], last["u_ratio"]),
            max(first.get("u_reference_relative", 0.0), last.get("u_reference_relative", 0.0)),
        )
        if moved:
            warnings.append(
                f"the lever's scale moved by {signed_percent(change, 3)} (u = {percent(u_change)}) between "
                "the checks before and after this run"
            )
    return [_result_entry(check, data, start) | {"found": check.details} for check, data in checks], warnings


def _read(path: Path, key: str = "") -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        where = "" if path.is_absolute() else f" in {Path.cwd()}, where the command was given"
        name = f"calibration.{key} = {str(path)!r}" if key else str(path)
        raise ConfigurationError(f"{name}: no such file{where}; rig calibrate makes one") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot read the calibration: {error.strerror or error}") from None
