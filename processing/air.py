"""Humid air: density and viscosity from what a laboratory's sensor reads."""

from math import exp, isfinite
from typing import Final, NamedTuple

_ZERO_C_K = 273.15
_DRY_J_PER_KG_K, _VAPOUR_J_PER_KG_K = 287.05, 461.5

POSSIBLE: Final = {
    "temperature_c": (-100.0, 200.0),
    "humidity_percent": (-10.0, 120.0),
    "pressure_pa": (1e4, 2e5),
}
"""What a sensor of a laboratory's air can say, in damp air beyond its scale too.

Beyond this it, or its wire, is broken, which many tell by -127 or -999.
"""


def is_possible(name: str, value: float) -> bool:
    """Whether a reading of this name is one of air."""
    lowest, highest = POSSIBLE[name]
    return isfinite(value) and lowest < value < highest


class Air(NamedTuple):
    """What resists a body that moves in it."""

    density_kg_per_m3: float
    viscosity_pa_s: float


def humid_air(temperature_c: float, humidity_percent: float, pressure_pa: float) -> Air:
    """Density of the mixture of two ideal gases, and viscosity of dry air, to half a per cent each.

    Saturation by Magnus's formula (WMO guide no. 8), viscosity by Sutherland's: 17.16 uPa s at 0 degrees
    Celsius, with 110.4 K.
    """
    kelvin = temperature_c + _ZERO_C_K
    vapour_pa = 0.01 * humidity_percent * 611.2 * exp(17.62 * temperature_c / (243.12 + temperature_c))
    density = (pressure_pa - vapour_pa) / (_DRY_J_PER_KG_K * kelvin) + vapour_pa / (
        _VAPOUR_J_PER_KG_K * kelvin
    )
    viscosity = 17.16e-6 * (kelvin / _ZERO_C_K) ** 1.5 * (_ZERO_C_K + 110.4) / (kelvin + 110.4)
    return Air(density, viscosity)
