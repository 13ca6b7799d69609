"""Calibrations from a digital calibration certificate: of a mass, of the lengths of a lever."""

import datetime
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from calibration import Certificate, CertifiedQuantity, Lever, is_certificate, parse_certificate
from processing.errors import ConfigurationError
from processing.units import conversion, size, unit_of_name
from rig.calibrate.filing import Filing, file_calibration
from rig.settings import validated

_NO_RESULTS: Final = ("nominalValue", "measurementError", "toleranceLimit", "referenceValue")
"""Beginnings of reference types, less their prefix, of what is not the measured value."""
_POSITIVE: Final = ("mass_kg", "arm_m", "pixel_pitch_m")
_LONGEST_PITCH_M = 1e-3


def certificate_in(path: Path) -> bytes | None:
    """The content of the file where it is a certificate, else None."""
    try:
        data = path.read_bytes() if path.is_file() else b""
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror or error}") from None
    return data if path.suffix.lower() == ".xml" or (path.suffix == "" and is_certificate(data)) else None


def calibrate_mass(path: Path, filing: Filing) -> Path:
    """The mass of the pendulum as a certificate states it; raises ConfigurationError where it states none."""
    data = certificate_in(path)
    if data is None:
        raise ConfigurationError(f"{path}: is not a digital calibration certificate (XML)")
    found = parse_certificate(data, str(path))
    one = _only(path, found, "mass_kg", lambda _: True)
    values = _value(path, "mass_kg", one)
    notes = []
    if any("conventional" in word.lower() for word in (*one.kinds, one.name)):
        notes.append(
            "a conventional mass, as weighed in air against steel; the buoyancy of a body of another density "
            "is not in it"
        )
    return _filed("mass", filing, path, data, found, values, [one], notes)


def lever_of_certificate(
    path: Path,
    data: bytes,
    filing: Filing,
    stated: Mapping[str, float] = MappingProxyType({}),
    sources: Sequence[Path] = (),
) -> Path:
    """The lever as a certificate states it: its keys by their names, or one arm and one pixel pitch.

    `stated` are values that hold where the certificate has none, from the files `sources`. Raises
    ConfigurationError where a value is missing.
    """
    found = parse_certificate(data, str(path))
    values, used = _named_values(path, found, Lever.model_fields)
    values = {**stated, **values}
    for name, fits in (("arm_m", _is_arm), ("pixel_pitch_m", _is_pitch)):
        if name not in values:
            one = _only(path, found, name, fits)
            values |= _value(path, name, one)
            used.append(one)
    lever, faults = validated(Lever, values)
    if lever is None:
        raise ConfigurationError(f"{path}: {'; '.join(fault.line for fault in faults)}")
    return _filed("lever", filing, path, data, found, lever.model_dump(exclude_none=True), used, [], sources)


def _filed(
    kind: Any,
    filing: Filing,
    path: Path,
    data: bytes,
    found: Certificate,
    values: Mapping[str, Any],
    used: Sequence[CertifiedQuantity],
    notes: Sequence[str],
    sources: Sequence[Path] = (),
) -> Path:
    """A certificate states no validity but by a date of recalibration; else it ages as calibrations do."""
    performed = datetime.datetime.combine(found.performed, datetime.time(), datetime.UTC)
    now = datetime.datetime.now(datetime.UTC)
    # the day of its own place may be one ahead
    if performed > now + datetime.timedelta(days=1):
        raise ConfigurationError(
            f"{path}: was calibrated on {found.performed}, which has not come yet (endPerformanceDate); ask "
            "the laboratory, or set the computer's clock"
        )
    until = None
    if found.recalibrate_by is not None:
        until = datetime.datetime.combine(found.recalibrate_by, datetime.time(23, 59, 59), datetime.UTC)
    details = {
        "certificate": found.identifier,
        "laboratory": found.laboratory,
        "item": found.item,
        "schema": found.schema,
        "certified": [
            {
                "name": each.name,
                "value": each.value,
                "unit": each.unit,
                "u": each.u,
                "k": each.k,
                "probability": each.probability,
            }
            for each in used
        ],
    }
    method = f"certificate {found.identifier or '?'} of {found.laboratory or '?'}"
    notes = [*notes, f"measured on {found.performed:%Y-%m-%d}"]
    if until is None:
        notes.append(f"states no date of recalibration: valid for {filing.valid_days:g} d from then on")
    return file_calibration(
        kind, filing, method, values, details, sources, notes, performed, until, {path.name: data}
    )


def _named_values(
    path: Path, found: Certificate, names: Mapping[str, Any]
) -> tuple[dict[str, Any], list[CertifiedQuantity]]:
    """Values by the keys that this program writes into a certificate of its own."""
    values, used = dict[str, Any](), []
    for one in found.quantities:
        name = next((kind.removeprefix("rig_") for kind in one.kinds if kind.startswith("rig_")), "")
        if name not in names:
            continue
        if name in values:
            raise ConfigurationError(f"{path}: states {name} twice")
        if name.endswith("_dof") or name == "binning":
            values[name] = one.value
            continue
        _require_unit(path, name, one)
        values |= _value(path, name, one) if f"u_{name}" in names else {name: one.value}
        used.append(one)
    return values, used


def _only(path: Path, found: Certificate, name: str, fits: Callable[[float], bool]) -> CertifiedQuantity:
    """The one measured number of the right unit with an uncertainty."""
    unit = unit_of_name(name)
    likely = [
        one
        for one in found.quantities
        if one.unit
        and size(one.unit).powers == size(unit).powers
        and fits(one.value * conversion(one.unit, unit))
    ]
    # one of zero is none, and a negative one is refused where it is used
    measured = [one for one in likely if one.u > 0 or one.u < 0]
    result = [one for one in measured if not any(_is_no_result(kind) for kind in one.kinds)]
    what = name.removesuffix(f"_{unit}").replace("_", " ")
    if len(result) == 1:
        return result[0]
    if result or len(measured) > 1:
        several = "; ".join(f"{one.name} = {one.value:g} {one.unit}" for one in result or measured)
        raise ConfigurationError(f"{path}: states several numbers that could be the {what}: {several}")
    if measured:
        return measured[0]
    if likely:
        raise ConfigurationError(
            f"{path}: {likely[0].name}: states no uncertainty, so it cannot be used as a {what}"
        )
    stated = ", ".join(dict.fromkeys(f"{one.name} ({one.unit or one.problem})" for one in found.quantities))
    raise ConfigurationError(
        f"{path}: states no {what} (in a unit like {unit}); it has: {stated or 'no numbers'}"
    )


def _is_no_result(kind: str) -> bool:
    return kind.rpartition("_")[2].startswith(_NO_RESULTS)


def _is_arm(length_m: float) -> bool:
    return length_m >= _LONGEST_PITCH_M


def _is_pitch(length_m: float) -> bool:
    return 0 < length_m < _LONGEST_PITCH_M


def _require_unit(path: Path, name: str, one: CertifiedQuantity) -> None:
    unit = unit_of_name(name)
    # counts have no unit of their own there
    wanted = "1" if unit in ("", "px") else unit
    if not one.unit or size(one.unit).powers != size(wanted).powers:
        raise ConfigurationError(
            f"{path}: {name} is stated in {one.unit or one.problem}, which cannot be converted to {wanted}"
        )


def _value(path: Path, name: str, one: CertifiedQuantity) -> dict[str, float]:
    """The number in the unit of its name, with its standard uncertainty."""
    unit = unit_of_name(name)
    factor = conversion(one.unit, "1" if unit in ("", "px") else unit)
    values = {name: one.value * factor}
    where = f"{one.name} = {one.value:g} {one.unit}"
    if not math.isfinite(one.value) or (name in _POSITIVE and not one.value > 0):
        raise ConfigurationError(f"{path}: {where} is no {name.removesuffix(f'_{unit}').replace('_', ' ')}")
    if not math.isnan(one.u) and not 0 <= one.u < math.inf:
        raise ConfigurationError(f"{path}: {where} with an uncertainty of {one.u:g}, which is none")
    return values if math.isnan(one.u) else values | {f"u_{name}": one.u * factor}
