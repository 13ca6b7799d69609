"""The balance's numbers: what they are called where a person reads them, and their table."""

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final, NamedTuple

from rig.presentation import palette
from rig.presentation.numbers import with_uncertainty

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


class Quantity(NamedTuple):
    """How a number of the balance is called, its unit, colour and panel ("": in the table alone).

    Ratios come as plain numbers and are shown in per cent.
    """

    label: str
    unit: str
    colour: str
    panel: str

    @property
    def scale(self) -> float:
        return 100.0 if self.unit == "%" else 1.0


BALANCE: Final[Mapping[str, Quantity]] = {
    "period_s": Quantity("period", "s", palette.GREY, ""),
    "amplitude_arcsec": Quantity("amplitude", "arcsec", palette.GREY, ""),
    "transverse_arcsec": Quantity("transverse", "arcsec", palette.X_COLOUR, "transverse"),
    "transverse_ratio": Quantity("transverse ratio", "%", palette.VERMILLION, "ratio"),
    "width_ratio": Quantity("ellipticity", "%", palette.YELLOW, "ratio"),
    "line_angle_deg": Quantity("tilt of the line", "deg", palette.BLUISH_GREEN, "tilt"),
    "rotation_deg_per_min": Quantity("rotation", "deg/min", palette.REDDISH_PURPLE, "rotation"),
    "rest_x_arcsec": Quantity("rest X", "arcsec", palette.X_COLOUR, "rest_x"),
    "rest_y_arcsec": Quantity("rest Y", "arcsec", palette.Y_COLOUR, "rest_y"),
    "drift_x_arcsec_per_min": Quantity("drift X", "arcsec/min", palette.X_COLOUR, "drift"),
    "drift_y_arcsec_per_min": Quantity("drift Y", "arcsec/min", palette.Y_COLOUR, "drift"),
    "period_ratio": Quantity("T_V / T_U", "", palette.BLUISH_GREEN, "period_ratio"),
}
PANELS: Final[Mapping[str, str]] = {
    "transverse": "Transverse amplitude / {unit}",
    "ratio": "Transverse, width / %",
    "tilt": "Tilt of the line / deg",
    "rotation": "Rotation of the line / (deg/min)",
    "rest_x": "Rest position X / {unit}",
    "rest_y": "Rest position Y / {unit}",
    "drift": "Drift X, Y / ({unit}/min)",
    "period_ratio": "T_V / T_U",
}
"""The balance's panels by name, and their titles."""


def balance_quantity(name: str, unit: str = "arcsec") -> Quantity:
    """How a number of the balance is shown; one without a description goes by its own name.

    `unit` replaces arcsec where deflections are in px for want of a calibration.
    """
    known = BALANCE.get(name) or Quantity(name.replace("_", " "), "", palette.GREY, "other")
    return known._replace(unit=known.unit.replace("arcsec", unit))


def balance_table(quantities: Mapping[str, tuple[float, float]], unit: str = "arcsec") -> str:
    """The balance as a table in Markdown."""
    lines = ["| | value ± u |", "|---|---:|"]
    for name, (value, u) in quantities.items():
        shown = balance_quantity(name, unit)
        label = f"{shown.label} / {shown.unit}" if shown.unit else shown.label
        lines.append(f"| {label} | {with_uncertainty(shown.scale * value, shown.scale * u)} |")
    return "\n".join(lines)


def balance_quantities(
    balance: "DataclassInstance | Mapping[str, float]", unit_rad: float
) -> dict[str, tuple[float, float]]:
    """The numbers of a balance with their uncertainties, in the units that a person reads.

    Every ``name`` that comes with a ``u_name`` is one. Names end in their units: ``_rad`` becomes
    degrees for angles of the line (``angle``, ``tilt``, ``rotation`` in the name), else the unit of
    the deflections (arcsec, or px: `unit_rad` 1 where there is no calibration); ``_per_s`` becomes
    per minute.
    """
    fields = balance if isinstance(balance, Mapping) else dataclasses.asdict(balance)
    shown: dict[str, tuple[float, float]] = {}
    for name, value in fields.items():
        u = fields.get(f"u_{name}")
        if u is None:
            continue
        stem, rate, scale = name, "", 1.0
        if stem.endswith("_per_s"):
            stem, rate, scale = stem.removesuffix("_per_s"), "_per_min", 60.0
        if stem.endswith("_rad"):
            stem = stem.removesuffix("_rad")
            of_the_line = any(word in stem for word in ("angle", "tilt", "rotation"))
            scale *= math.degrees(1.0) if of_the_line else 1.0 / unit_rad
            stem += "_deg" if of_the_line else "_arcsec"
        shown[stem + rate] = (scale * float(value), scale * float(u))
    return shown
