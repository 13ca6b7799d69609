"""Quantities of the balance: their table, and how Rerun draws them."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final, NamedTuple

from rig.presentation import palette
from rig.presentation.quantities import quantity

if TYPE_CHECKING:
    from processing.balance import Balance


class Drawn(NamedTuple):
    """Name of a quantity's entity in Rerun, its colour, and its panel (empty: in the table only)."""

    entity: str
    colour: str = palette.GREY
    panel: str = ""


BALANCE: Final[Mapping[str, Drawn]] = {
    "period_s": Drawn("period"),
    "amplitude": Drawn("amplitude"),
    "transverse": Drawn("transverse", palette.X_COLOUR, "Transverse amplitude"),
    "transverse_ratio": Drawn("transverse_ratio", palette.VERMILLION, "Transverse, width"),
    "width_ratio": Drawn("width_ratio", palette.YELLOW, "Transverse, width"),
    "line_angle_rad": Drawn("line_angle", palette.BLUISH_GREEN, "Tilt of the line"),
    "rotation_rad_per_s": Drawn("rotation", palette.REDDISH_PURPLE, "Rotation of the line"),
    "rest_x": Drawn("rest_x", palette.X_COLOUR, "Rest position X"),
    "rest_y": Drawn("rest_y", palette.Y_COLOUR, "Rest position Y"),
    "drift_x_per_s": Drawn("drift_x", palette.X_COLOUR, "Drift X, Y"),
    "drift_y_per_s": Drawn("drift_y", palette.Y_COLOUR, "Drift X, Y"),
    "period_ratio": Drawn("period_ratio", palette.BLUISH_GREEN, "T_V / T_U"),
}
"""By the name in `processing.balance.Balance`."""


def balance_drawn(key: str) -> Drawn:
    """How a quantity of the balance is drawn; one that is not listed has its own name and no panel."""
    return BALANCE.get(key) or Drawn(key)


def balance_panels(unit: str) -> dict[str, list[str]]:
    """The entities in each panel, by the panel's title with its unit.

    All quantities of a panel are shown in the same unit; `unit` is that of deflections.
    """
    panels: dict[str, list[str]] = {}
    for key, drawn in BALANCE.items():
        if drawn.panel:
            title = dataclasses.replace(quantity(key, unit), symbol=drawn.panel).label
            panels.setdefault(title, []).append(drawn.entity)
    return panels


def balance_numbers(balance: "Balance") -> dict[str, tuple[float, float]]:
    """Every `name` of a balance that comes with a `u_name`: value and standard uncertainty as stored."""
    fields = dataclasses.asdict(balance)
    return {name: (value, fields[f"u_{name}"]) for name, value in fields.items() if f"u_{name}" in fields}


def balance_table(numbers: Mapping[str, tuple[float, float]], unit: str) -> str:
    """The balance as a table in Markdown; `unit` is that of deflections as shown: arcsec or px."""
    lines = ["| | value ± u |", "|---|---:|"]
    for key, (value, u) in numbers.items():
        shown = quantity(key, unit)
        lines.append(f"| {shown.label} | {shown.text(value, u)} |")
    return "\n".join(lines)
