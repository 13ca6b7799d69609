"""A calibration file as tables for display: values, budget and residuals."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from calibration import CalibrationFile, read_calibration, toml_value
from processing.units import ARCSEC_RAD
from rig.terminal import Table

_ROUNDING_DN2 = 1.0 / 12.0
"""Variance of the rounding to whole DN."""


@dataclass(frozen=True, slots=True)
class CalibrationReport:
    """A calibration file prepared for display.

    Parameters
    ----------
    path, calibration
        The file and its content.
    tables
        Values, budget and residuals, as far as its kind has them.
    configuration
        The lines of the configuration that use it.
    """

    path: Path
    calibration: CalibrationFile
    tables: Sequence[Table]
    configuration: str


def read_calibration_report(path: Path) -> CalibrationReport:
    """The report of a calibration file; raises ConfigurationError if it cannot be read."""
    calibration = read_calibration(path)
    name = toml_value(path.as_posix())
    stated = f"checks = [{name}]" if calibration.kind == "check" else f"{calibration.kind} = {name}"
    tables = [table for table in (_values(calibration), *_kind_tables(calibration)) if table.shown]
    return CalibrationReport(path, calibration, tables, f"[calibration]\n{stated}")


def numbers_of(calibration: CalibrationFile) -> dict[str, bool | str | int | float]:
    """Single values of a calibration by name: its values, then its details."""
    numbers: dict[str, bool | str | int | float] = {}
    for name, value in (*calibration.values.items(), *calibration.details.items()):
        # a pointing calibration has values for each axis
        for inner, part in value.items() if isinstance(value, Mapping) else (("", value),):
            if isinstance(part, bool | str | int | float):
                numbers[f"{name}.{inner}" if inner else name] = part
    if "hot_pixels_xy" in calibration.details:
        numbers["hot_pixels"] = len(calibration.details["hot_pixels_xy"])
    return numbers


def _values(file: CalibrationFile) -> Table:
    return _table(
        "values", f"{file.kind}: {file.method}", ("quantity", "value"), list(numbers_of(file).items())
    )


def _kind_tables(calibration: CalibrationFile) -> Iterator[Table]:
    details = calibration.details
    if budget := details.get("budget"):
        yield _budget([line for line in budget if line["value"] or line["u"]])
    if "residual_px" in details:
        yield _steps(details)
    if "signal_dn" in details:
        yield _transfer(calibration.values, details)
    if calibration.kind in ("axes", "clock", "shutter", "air"):
        yield from _residual_tables(calibration)
    if jumps := details.get("jumps"):
        rows = [(jump["frame"], 1e6 * jump["step_s"]) for jump in jumps]
        yield _table("jumps", "jumps of the clock", ("from frame", "step, µs"), rows)
    for axis in ("x", "y"):
        if isinstance(details.get(axis), Mapping) and "allan_tau_s" in details[axis]:
            yield _allan(axis, details[axis])


def _budget(lines: Sequence[Mapping[str, Any]]) -> Table:
    """Table of the contribution of each input to the uncertainty of the scale, and of its effect on it."""
    has_effects = any(line["effect"] for line in lines)
    head = ["input", "value", "u", *(["effect, %"] if has_effects else []), "contribution, %"]
    note = "Largest contribution first: standard uncertainty of the scale by that of the input."
    if has_effects:
        note += " Effect: change of the scale against the same lever with this input 0."
    return _table(
        "budget",
        "budget of the scale",
        head,
        [
            [line["name"], line["value"], line["u"]]
            + ([100.0 * line["effect"]] if has_effects else [])
            + [100.0 * line["contribution"]]
            for line in lines
        ],
        note,
    )


_RESIDUALS: Final = (
    ("direction of the slow mode", "slow_at_s", "at, s", 1.0, "slow_off_rad", "off the mean, mrad", 1e3),
    ("direction of the fast mode", "fast_at_s", "at, s", 1.0, "fast_off_rad", "off the mean, mrad", 1e3),
    ("arrivals of frames", "parts_at_s", "at, s", 1.0, "off_line_s", "off the line, µs", 1e6),
    (
        "drag of each run, with the contact of all",
        "areas_m2", "area of vanes, cm²", 1e4, "off_drags_s", "off the line, µs", 1e6,
    ),
    ("row time by stretch", "stretches_at_s", "at, s", 1.0, "off_stretches_s", "off the mean, µs", 1e6),
)  # fmt: skip
"""Residuals of axes, clock, air and shutter: title, then detail, heading and display factor of both columns.

Standard uncertainties are the detail with the name of the second column after ``u_``.
"""


def _residual_tables(calibration: CalibrationFile) -> Iterator[Table]:
    """Tables of residuals of axes, clock, shutter and air."""
    details = dict(calibration.details)
    for mode in ("slow", "fast"):
        parts = details.get(f"{mode}_parts") or {}
        details |= {f"{mode}_at_s": parts.get("at_s"), f"{mode}_off_rad": parts.get("off_rad")}
        details[f"u_{mode}_off_rad"] = parts.get("u_off_rad")
    if "off_drags_s" in details:
        details["u_off_drags_s"] = details["u_drags_s"]
    if "of_stretches_s" in details:
        mean_s = details["fitted_row_time_s"]
        details["off_stretches_s"] = [value - mean_s for value in details["of_stretches_s"]]
        details["u_off_stretches_s"] = details["u_of_stretches_s"]
    for title, x, x_name, x_factor, y, y_name, y_factor in _RESIDUALS:
        if details.get(x) and details.get(y):
            rows = [
                (x_factor * at, y_factor * deviation, y_factor * u)
                for at, deviation, u in zip(details[x], details[y], details[f"u_{y}"], strict=True)
            ]
            yield _table("residuals", title, (x_name, y_name, "u"), rows)


def _steps(details: Mapping[str, Any]) -> Table:
    """Table of the steps of a ladder: residuals, and change of the scale without each step."""
    unit, size = ("arcsec", ARCSEC_RAD) if details["kind"] == "tilt" else ("mm", 1e-3)
    return _table(
        "residuals",
        "residuals of the steps",
        ("step", f"reference, {unit}", "x, px", "y, px", "scale without it, u"),
        [
            (number, reference / size, *residual, scale_without)
            for number, (reference, residual, scale_without) in enumerate(
                zip(details["reference"], details["residual_px"], details["leave_one_out"], strict=True), 1
            )
        ],
    )


def _transfer(values: Mapping[str, Any], details: Mapping[str, Any]) -> Table:
    """Table of the photon transfer: variance by signal, and its deviation from read noise and shot noise."""
    gain = values["gain_e_per_dn"]
    bend_per_dn = 3.0 * details.get("non_linearity", 0.0) / values["full_scale_dn"]
    dark_dn2 = (values["read_noise_e"] / gain) ** 2 + _ROUNDING_DN2
    return _table(
        "residuals",
        "residuals of the levels",
        ("signal, DN", "variance, DN²", "off the line, DN²", "off the line, u"),
        [
            (
                signal,
                variance,
                deviation := variance - dark_dn2 - signal / gain * (1.0 - bend_per_dn * signal),
                deviation / u,
            )
            for signal, variance, u in zip(
                details["signal_dn"], details["variance_dn2"], details["u_variance_dn2"], strict=True
            )
        ],
    )


def _allan(axis: str, details: Mapping[str, Any]) -> Table:
    """Table of Allan deviations, at averaging times that at least double."""
    rows: list[tuple[float, float, float]] = []
    for row in zip(details["allan_tau_s"], details["allan_px"], details["u_allan_px"], strict=True):
        if not rows or row[0] >= 2.0 * rows[-1][0]:
            rows.append(row)
    return _table(f"allan_{axis}", f"Allan deviation of {axis}", ("averaged, s", "px", "u, px"), rows)


def _table(
    name: str, title: str, head: Sequence[str], rows: Sequence[Sequence[Any]], note: str = ""
) -> Table:
    shown = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    return Table(name, title, head, shown, note)
