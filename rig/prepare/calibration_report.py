"""A calibration file as tables for display: values, budget, steps of a ladder, jumps of a clock."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration import CalibrationFile, read_calibration, toml_value
from processing.units import ARCSEC_RAD
from rig.terminal import Table


@dataclass(frozen=True, slots=True)
class CalibrationReport:
    """A calibration file prepared for display."""

    path: Path
    calibration: CalibrationFile
    tables: Sequence[Table]
    """Values, and budget, steps of a ladder or jumps of a clock where its kind has them."""
    configuration: str
    """Lines of a configuration that use the file."""


def read_calibration_report(path: Path) -> CalibrationReport:
    """The report of a calibration file; raises ConfigurationError if it cannot be read."""
    calibration = read_calibration(path)
    name = toml_value(path.as_posix())
    line = f"checks = [{name}]" if calibration.kind == "check" else f"{calibration.kind} = {name}"
    tables = [table for table in (_values(calibration), *_kind_tables(calibration)) if table.shown]
    return CalibrationReport(path, calibration, tables, f"[calibration]\n{line}")


def scalar_values(calibration: CalibrationFile) -> dict[str, bool | str | int | float]:
    """Values and details of a calibration that are single values, by name."""
    scalars: dict[str, bool | str | int | float] = {}
    for name, value in (*calibration.values.items(), *calibration.details.items()):
        # a pointing calibration has values for each axis
        for axis, scalar in value.items() if isinstance(value, Mapping) else (("", value),):
            if isinstance(scalar, bool | str | int | float):
                scalars[f"{name}.{axis}" if axis else name] = scalar
    if "hot_pixels_xy" in calibration.details:
        scalars["hot_pixels"] = len(calibration.details["hot_pixels_xy"])
    return scalars


def _values(calibration: CalibrationFile) -> Table:
    rows = list(scalar_values(calibration).items())
    return _table("values", f"{calibration.kind}: {calibration.method}", ("quantity", "value"), rows)


def _kind_tables(calibration: CalibrationFile) -> Iterator[Table]:
    details = calibration.details
    if budget := details.get("budget"):
        yield _budget([line for line in budget if line["value"] or line["u"]])
    if "residual_px" in details:
        yield _steps(details)
    if jumps := details.get("jumps"):
        rows = [(jump["frame"], 1e6 * jump["step_s"]) for jump in jumps]
        yield _table("jumps", "jumps of the clock", ("from frame", "step, µs"), rows)


def _budget(lines: Sequence[Mapping[str, Any]]) -> Table:
    """Table of the contribution of each input to the uncertainty of the scale, and of its effect on it."""
    has_effects = any(line["effect"] for line in lines)
    head = ["input", "value", "u", *(["effect, %"] if has_effects else []), "contribution, %"]
    note = "Contribution: standard uncertainty of the scale due to that of the input; the largest is first."
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


def _steps(details: Mapping[str, Any]) -> Table:
    """Table of the steps of a ladder: residuals, and change of the scale, in its u, without each step."""
    unit, size = ("arcsec", ARCSEC_RAD) if details["kind"] == "tilt" else ("mm", 1e-3)
    return _table(
        "residuals",
        "residuals of the steps",
        ("step", f"reference, {unit}", "x, px", "y, px", "change of scale without it, u"),
        [
            (number, reference / size, *residual, scale_without)
            for number, (reference, residual, scale_without) in enumerate(
                zip(details["reference"], details["residual_px"], details["leave_one_out"], strict=True), 1
            )
        ],
    )


def _table(
    name: str, title: str, head: Sequence[str], rows: Sequence[Sequence[Any]], note: str = ""
) -> Table:
    texts = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    return Table(name, title, head, texts, note)
