"""Display of the declared quantities, and their styles in Rerun."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple

from processing.ambient import AmbientConditions
from processing.number_text import with_uncertainty
from processing.quantity import DecayQuantities, InstrumentQuantities, Quantity, quantities_of
from processing.units import ARCSEC_RAD, unit_of_name
from rig.terminal import palette

if TYPE_CHECKING:
    from processing.balance import Balance
    from processing.contact import Parameter


_ANGLE = ("arcsec", "rad")


@dataclass(frozen=True, slots=True)
class QuantityDisplay:
    """Presentation of a quantity."""

    symbol: str
    unit: str
    """Unit of the displayed number; empty for a dimensionless quantity."""
    name: str
    factor: float = 1.0
    """The displayed number is the stored value times this factor."""

    @property
    def label(self) -> str:
        """Heading of a row, a column or an axis, such as `γ / MPa`."""
        if not self.unit:
            return self.symbol
        return f"{self.symbol} / ({self.unit})" if "/" in self.unit else f"{self.symbol} / {self.unit}"

    def text(self, value: float, u: float) -> str:
        """Text of a stored value and its standard uncertainty, in the shown unit."""
        return with_uncertainty(value * self.factor, u * self.factor)

    def in_px(self) -> "QuantityDisplay":
        """The same quantity for deflections stored in px, without a calibrated lever."""
        if not self.unit.startswith("arcsec"):
            return self
        return replace(self, unit=self.unit.replace("arcsec", "px"), factor=self.factor * ARCSEC_RAD)


def quantity(key: str, unit: str = "arcsec") -> QuantityDisplay:
    """Presentation of the quantity with this key; of an unknown one by the key itself.

    `unit` is the unit of deflections: arcsec, or px without a calibrated lever.
    """
    declared = declaration(key)
    if declared is None:
        return QuantityDisplay(key.replace("_", " "), "", key.replace("_", " "))
    si = "" if declared.unit == "1" else declared.unit
    display = QuantityDisplay(declared.symbol, declared.shown or si, declared.meaning, declared.factor)
    return display.in_px() if unit == "px" else display


def declaration(key: str) -> Quantity | None:
    """Declaration of the quantity with this key; None for an unknown key."""
    return _declarations().get(key)


def unit_of(key: str) -> str:
    """SI unit of the quantity with this key, "1" for a plain number; empty for an unknown key."""
    declared = declaration(key.removeprefix("u_"))
    return unit_of_name(key) if declared is None else declared.unit


@cache
def _declarations() -> Mapping[str, Quantity]:
    """All declared quantities by key."""
    # imported here, because compiled functions load slowly
    from processing.balance import Balance
    from processing.fit import DerivedQuantity, FitQuality, Work

    kinds = (InstrumentQuantities, DerivedQuantity, FitQuality, Work, DecayQuantities)
    declarations = {key: declared for kind in kinds for key, declared in quantities_of(kind).items()}
    declarations |= {key: parameter.quantity for key, parameter in law_parameters().items()}
    for kind in (Balance, AmbientConditions, PlottedQuantities):
        declarations |= quantities_of(kind)
    return declarations


@cache
def law_parameters() -> Mapping[str, "Parameter"]:
    """All parameters of all laws by their keys, and drag and start values, which every fit has."""
    from processing.contact import AMPLITUDE, DRAG, LAWS, TIME

    of_laws = [parameter for law in LAWS.values() for parameter in law.parameters]
    # a key of several laws has the description of the first law
    return {parameter.key: parameter for parameter in reversed((*of_laws, DRAG, AMPLITUDE, TIME))}


SOURCES: Final[Mapping[str, str]] = {
    "swings": "half-cycles",
    "ground": "motion of the ground",
    "discrepancy": "model discrepancy",
    "friction_step": "a step of the friction",
    "rest_position": "rest beside the contact's middle",
    "position_errors": "fixed-pattern error",
    "drifts": "drifts over the run, as fitted",
    "boundary_layer_drag": "boundary-layer drag",
    "air": "drag of the air, as known",
    "mass_kg": "mass",
    "ball_radius_m": "ball radius R",
    "gravity_m_per_s2": "local g",
    "arm_m": "lever arm",
    "pitch_m": "pixel pitch",
    "clock": "clock",
    "ageing": "ageing of the friction",
    "adhesion_ageing": "ageing of the adhesion",
    "drag_drift": "drift of the air's drag",
    "period_drift": "drift of the period (temperature)",
    "row_time_s": "row time of the shutter",
    "common_amplitude_rad": "compression of the film, all amplitudes",
    "plane_of_swing_rad": "plane of swing, as it turned",
    "flat_youngs_modulus_pa": "E of the flat",
    "flat_poisson_ratio": "ν of the flat",
    "ball_youngs_modulus_pa": "E of the ball",
    "ball_poisson_ratio": "ν of the ball",
}
"""Names of the sources of an uncertainty budget."""


@dataclass(frozen=True, slots=True)
class PlottedQuantities:
    """Quantities that only the desk's charts, or campaigns as covariates, show."""

    elapsed_s: Annotated[float, Quantity("t", "time since the record began", "s")]
    deflection_x: Annotated[float, Quantity("X", "deflection across the swing", *_ANGLE)]
    deflection_y: Annotated[float, Quantity("Y", "deflection along the swing", *_ANGLE)]
    sharpness_per_px: Annotated[float, Quantity("sharpness", "larger is sharper", "1/px", "1/px")]
    level_dn: Annotated[float, Quantity("level", "grey value of a pixel", "DN", "DN")]
    pixels: Annotated[float, Quantity("lg(1 + pixels)", "pixels of a grey value, as a logarithm", unit="1")]
    order: Annotated[float, Quantity("run", "order of the runs", unit="1")]
    first_amplitude_rad: Annotated[float, Quantity("first amplitude", "first amplitude", "arcsec")]
    load_n: Annotated[float, Quantity("load", "load", unit="N")]


class RerunStyle(NamedTuple):
    """Presentation of a quantity of the balance in Rerun."""

    entity: str
    colour: str = palette.GREY
    panel: str = ""
    """Title of the panel with its curve; empty if it stands in the table alone."""


BALANCE_STYLES: Final[Mapping[str, RerunStyle]] = {
    "period_s": RerunStyle("period"),
    "amplitude": RerunStyle("amplitude"),
    "transverse": RerunStyle("transverse", palette.X_COLOUR, "Transverse amplitude"),
    "transverse_ratio": RerunStyle("transverse_ratio", palette.VERMILLION, "Transverse, width"),
    "width_ratio": RerunStyle("width_ratio", palette.YELLOW, "Transverse, width"),
    "line_angle_rad": RerunStyle("line_angle", palette.BLUISH_GREEN, "Tilt of the line"),
    "rotation_rad_per_s": RerunStyle("rotation", palette.REDDISH_PURPLE, "Rotation of the line"),
    "rest_x": RerunStyle("rest_x", palette.X_COLOUR, "Rest position X"),
    "rest_y": RerunStyle("rest_y", palette.Y_COLOUR, "Rest position Y"),
    "drift_x_per_s": RerunStyle("drift_x", palette.X_COLOUR, "Drift X, Y"),
    "drift_y_per_s": RerunStyle("drift_y", palette.Y_COLOUR, "Drift X, Y"),
    "period_ratio": RerunStyle("period_ratio", palette.BLUISH_GREEN, "T_V / T_U"),
}
"""Styles by field of `Balance`."""


def balance_style(key: str) -> RerunStyle:
    """Style of a quantity of the balance in Rerun; by default its own name and no panel."""
    return BALANCE_STYLES.get(key) or RerunStyle(key)


def balance_panels(unit: str) -> dict[str, list[str]]:
    """The entities in each panel, by the panel's title with its unit.

    All quantities of a panel have the same unit; `unit` is that of deflections.
    """
    panels: dict[str, list[str]] = {}
    for key, style in BALANCE_STYLES.items():
        if style.panel:
            title = replace(quantity(key, unit), symbol=style.panel).label
            panels.setdefault(title, []).append(style.entity)
    return panels


def balance_numbers(balance: "Balance") -> dict[str, tuple[float, float]]:
    """Value and standard uncertainty, as stored, of every field of a balance that has a `u_` field."""
    fields = asdict(balance)
    return {name: (value, fields[f"u_{name}"]) for name, value in fields.items() if f"u_{name}" in fields}


def balance_table(numbers: Mapping[str, tuple[float, float]], unit: str) -> str:
    """The balance as a table in Markdown; `unit` is that of deflections as shown: arcsec or px."""
    lines = ["| | value ± u |", "|---|---:|"]
    for key, (value, u) in numbers.items():
        display = quantity(key, unit)
        lines.append(f"| {display.label} | {display.text(value, u)} |")
    return "\n".join(lines)
