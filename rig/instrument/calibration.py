"""Calibration files: they fill the configuration, are attached to records and judged for validity."""

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


def fill_from_files(config: Configuration) -> Configuration:
    """The configuration with the sections given by its calibration files.

    Raises ConfigurationError for a file that is missing, of another kind or not a calibration, and for a
    section that is also stated with different values. An expired file is used, and the results report it.
    """
    update: dict[str, Any] = {}
    for kind, section in _SECTIONS.items():
        path: Path | None = getattr(config.calibration, kind)
        if path is None:
            continue
        found = parse_calibration(_read(path, kind), str(path), kind)
        tree = {"camera": {"driver": config.camera.driver}, section: _section_values(found)}
        values = getattr(validate_configuration(tree, str(path)), section)
        if isinstance(values, Lever):
            values = values.with_binning(config.camera.pitch_factor)
        stated = getattr(config, section)
        if stated not in (None, values):
            raise ConfigurationError(
                f"[{section}] differs from the values in calibration.{kind} = {str(path)!r}; "
                "leave one of them out"
            )
        update[section] = values
    air = config.calibration.air
    if air is not None:
        found = parse_calibration(_read(air, "air"), str(air), "air")
        # a stated "open" or "vacuum" takes precedence over the file
        if config.fit.drag == "air":
            update["fit"] = _with_measured_drag(config, found, air)
    if config.calibration.pointing is not None:
        parse_calibration(_read(config.calibration.pointing, "pointing"), str(config.calibration.pointing))
    for path in config.calibration.checks:
        parse_calibration(_read(path, "checks"), str(path))
    return config.model_copy(update=update)


def _with_measured_drag(config: Configuration, found: CalibrationFile, path: Path) -> FitSettings:
    """Fit settings with the drag of a calibration; raises ConfigurationError if another is stated."""
    stated = config.fit
    tree = {"camera": {"driver": config.camera.driver}, "fit": stated.model_dump() | found.values}
    filled = validate_configuration(tree, str(path)).fit
    if stated.drag_s is not None and stated != filled:
        raise ConfigurationError(
            f"fit.drag_s = {stated.drag_s:g} differs from the values in calibration.air = {str(path)!r}; "
            "leave one of them out"
        )
    return filled


def _section_values(found: CalibrationFile) -> dict[str, Any]:
    """Values of the section: those of the file, and for a sensor its hot pixels from the details."""
    hot = found.details.get("hot_pixels_xy") if found.kind == "sensor" else None
    return {**found.values, **({"hot_pixels_xy": hot} if hot else {})}


def calibration_attachments(config: Configuration) -> dict[str, bytes]:
    """Contents of the calibration files in use, by attachment name."""
    paths = {kind: getattr(config.calibration, kind) for kind in (*_SECTIONS, "air", "pointing")}
    found = {f"{PREFIX}{kind}.toml": _read(path) for kind, path in paths.items() if path is not None}
    for number, path in enumerate(config.calibration.checks, 1):
        found[f"{PREFIX}check-{number}.toml"] = _read(path)
    return found


def judge_calibration(
    config: Configuration,
    attachments: Mapping[str, bytes],
    began: datetime.datetime,
    ended: datetime.datetime,
) -> tuple[dict[str, Any], list[str]]:
    """The calibration part of a run's results, and warnings.

    Parameters
    ----------
    config, attachments
        Those of the record. Checks named in `config` but missing in the record are read from their files,
        because a check after a series is made when its records are already closed.
    began, ended
        Start and end of the run.
    """
    tree: dict[str, Any] = {}
    warnings: list[str] = []
    missing = []
    for kind, section in _SECTIONS.items():
        data = attachments.get(f"{PREFIX}{kind}.toml")
        if data is not None:
            found = parse_calibration(data, f"{PREFIX}{kind}.toml", kind)
            tree[kind] = _result_entry(found, data, began)
            warnings += _expiry_warning(kind, found, began)
        elif kind == "shutter" and config.shutter is None:
            continue  # a global shutter needs no calibration
        elif config.simulated:
            tree[kind] = {
                "validity": "simulated",
                "text": "true values of the simulated rig, or stated in the configuration",
            }
        elif getattr(config, section) is not None:
            tree[kind] = {
                "validity": "stated",
                "text": "stated in the configuration, without a calibration file",
            }
        else:
            tree[kind] = {"validity": "missing", "text": "no calibration"}
            missing.append(kind)
    if missing:
        warnings.append(f"not calibrated: {', '.join(missing)} (rig calibrate)")
    others: tuple[Kind, ...] = ("air", "pointing")
    for kind in others:
        data = attachments.get(f"{PREFIX}{kind}.toml")
        if data is not None:
            measured = parse_calibration(data, f"{kind}.toml", kind)
            tree[kind] = _result_entry(measured, data, began)
            warnings += _expiry_warning(kind, measured, began)
    checks, lines = _checks(config, attachments, began, ended)
    if checks:
        tree["checks"] = checks
    return tree, [*warnings, *lines]


def _expiry_warning(kind: str, found: CalibrationFile, at: datetime.datetime) -> list[str]:
    """The warning that a calibration had expired before the run; empty if it had not."""
    if not found.expired(at):
        return []
    days = (at - found.measured_at).total_seconds() / 86400
    since = f"it was measured on {found.measured_at:%Y-%m-%d}, {days:.0f} d before the run"
    return [f"the calibration of the {kind} had expired on {found.valid_until:%Y-%m-%d}: {since}"]


def _result_entry(found: CalibrationFile, data: bytes, at: datetime.datetime) -> dict[str, Any]:
    return {
        "validity": "expired" if found.expired(at) else "valid",
        "text": f"{found.method}; by {found.made_by or '?'}, valid until {found.valid_until:%Y-%m-%d}",
        "sha256": hashlib.sha256(data).hexdigest(),
        **found.model_dump(
            mode="json",
            exclude={"details", "schema_version"},
        ),
    }


def _checks(
    config: Configuration,
    attachments: Mapping[str, bytes],
    began: datetime.datetime,
    ended: datetime.datetime,
) -> tuple[list[dict[str, Any]], list[str]]:
    """Known-angle checks in order of time, and warnings of a lever's scale that is wrong or has changed."""
    raw = [data for name, data in sorted(attachments.items()) if name.startswith(f"{PREFIX}check-")]
    raw += [_read(path) for path in config.calibration.checks if path.is_file()]
    found = [(parse_calibration(data, "check", "check"), data) for data in dict.fromkeys(raw)]
    found.sort(key=lambda item: item[0].measured_at)
    warnings = []
    if len(found) < len(config.calibration.checks):
        gone = [str(path) for path in config.calibration.checks if not path.is_file()]
        warnings.append(f"known-angle checks that could not be read: {', '.join(gone)}")
    for check, _ in found:
        if check.details.get("moved"):
            ratio, u = check.details["ratio"], check.details["u_both"]
            warnings.append(
                f"known angles on {check.measured_at:%Y-%m-%d %H:%M}: the lever's scale is off by "
                f"{signed_percent(ratio - 1, 3)} (u = {percent(u)})"
            )
    before = [check for check, _ in found if check.measured_at <= began]
    after = [check for check, _ in found if check.measured_at >= ended]
    if before and after:
        first, last = before[-1].details, after[0].details
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
    return [_result_entry(check, data, began) | {"found": check.details} for check, data in found], warnings


def _read(path: Path, key: str = "") -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        where = "" if path.is_absolute() else f" in {Path.cwd()}, where the command was given"
        stated_as = f"calibration.{key} = {str(path)!r}" if key else str(path)
        raise ConfigurationError(f"{stated_as}: no such file{where}; rig calibrate makes one") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot read the calibration: {error.strerror or error}") from None
