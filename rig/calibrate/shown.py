"""A calibration file as tables: its values, the budget of its uncertainty, and what the fit left over."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from calibration import CalibrationFile
from processing.angle import ARCSEC_RAD
from rig.presentation import Table

_ROUNDING_DN2 = 1.0 / 12.0
"""Variance of a number that is rounded to integers, uniform over one."""


def calibration_tables(found: CalibrationFile) -> list[Table]:
    """Values, budget, residuals, as far as this kind has them."""
    return [table for table in (_values(found), *_of_kind(found)) if table.shown]


def _values(found: CalibrationFile) -> Table:
    rows = [
        (name, value)
        for name, value in {**found.values, **found.details}.items()
        if isinstance(value, bool | str | int | float)
    ]
    return _table("values", f"{found.kind}: {found.method}", ("quantity", "value"), rows)


def _of_kind(found: CalibrationFile) -> Iterator[Table]:
    details = found.details
    if budget := details.get("budget"):
        yield _budget([line for line in budget if line["value"] or line["u"]])
    if "residual_px" in details:
        yield _steps(details)
    if "signal_dn" in details:
        yield _transfer(found.values, details)
    for axis in ("x", "y"):
        if isinstance(details.get(axis), Mapping) and "allan_tau_s" in details[axis]:
            yield _allan(axis, details[axis])


def _budget(lines: Sequence[Mapping[str, Any]]) -> Table:
    """What each input adds to the uncertainty of the scale; and by how much it moves it, where one does."""
    moved = any(line["effect"] for line in lines)
    head = ["input", "value", "u", *(["effect, %"] if moved else []), "contribution, %"]
    note = "Largest contribution first: standard uncertainty of the scale by that of the input."
    if moved:
        note += " Effect: change of the scale against the same lever with this input 0."
    return _table(
        "budget",
        "budget of the scale",
        head,
        [
            [line["name"], line["value"], line["u"]]
            + ([100.0 * line["effect"]] if moved else [])
            + [100.0 * line["contribution"]]
            for line in lines
        ],
        note,
    )


def _steps(details: Mapping[str, Any]) -> Table:
    """The steps of a ladder: what the line leaves over, and how the scale would change without the step."""
    tilts = details["kind"] == "tilt"
    unit, size = ("arcsec", ARCSEC_RAD) if tilts else ("mm", 1e-3)
    return _table(
        "residuals",
        "residuals of the steps",
        ("step", f"reference, {unit}", "x, px", "y, px", "scale without it, u"),
        [
            (number, reference / size, *residual, without)
            for number, (reference, residual, without) in enumerate(
                zip(details["reference"], details["residual_px"], details["leave_one_out"], strict=True), 1
            )
        ],
    )


def _transfer(values: Mapping[str, Any], details: Mapping[str, Any]) -> Table:
    """The levels: variance against that of the fitted line, read noise and shot noise."""
    gain = values["gain_e_per_dn"]
    dark_dn2 = (values["read_noise_e"] / gain) ** 2 + _ROUNDING_DN2
    return _table(
        "residuals",
        "residuals of the levels",
        ("signal, DN", "variance, DN²", "off the line, DN²", "off the line, u"),
        [
            (signal, variance, rest := variance - dark_dn2 - signal / gain, rest / u)
            for signal, variance, u in zip(
                details["signal_dn"], details["variance_dn2"], details["u_variance_dn2"], strict=True
            )
        ],
    )


def _allan(axis: str, details: Mapping[str, Any]) -> Table:
    """Noise against averaging time, each time at least twice the one before."""
    rows: list[tuple[float, float, float]] = []
    for row in zip(details["allan_tau_s"], details["allan_px"], details["u_allan_px"], strict=True):
        if not rows or row[0] >= 2.0 * rows[-1][0]:
            rows.append(row)
    return _table(f"allan_{axis}", f"Allan deviation of {axis}", ("averaged, s", "px", "u, px"), rows)


def _table(
    name: str, title: str, head: Sequence[str], rows: Sequence[Sequence[Any]], note: str = ""
) -> Table:
    shown = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    return Table(name, title, tuple(head), [tuple(row) for row in rows], tuple(head), shown, note)
