"""Ambient conditions of a run: the air with its density and viscosity, dwell of the ball, age of surfaces."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import exp, isfinite, nan
from typing import Annotated, Final, NamedTuple

from processing.quantity import Quantity

_ZERO_C_K = 273.15
_DRY_AIR_J_PER_KG_K, _VAPOUR_J_PER_KG_K = 287.05, 461.5
"""Specific gas constants."""

POSSIBLE_READINGS: Final = {
    "temperature_c": (-100.0, 200.0),
    "humidity_percent": (-10.0, 120.0),
    "pressure_pa": (1e4, 2e5),
}
"""Range of the readings that a working sensor of a laboratory's air can give.

The range includes readings beyond 100 % in damp air. A reading outside it, often -127 or -999, means that the
sensor or its wire is broken.
"""


def is_possible(name: str, value: float) -> bool:
    """Whether a working sensor in air can give a reading `value` of the quantity `name`."""
    lowest, highest = POSSIBLE_READINGS[name]
    return isfinite(value) and lowest < value < highest


class Air(NamedTuple):
    """Properties of air that determine its drag."""

    density_kg_per_m3: float
    viscosity_pa_s: float


def humid_air(temperature_c: float, humidity_percent: float, pressure_pa: float) -> Air:
    """Density and viscosity of humid air, to half a per cent each.

    The density is that of a mixture of two ideal gases, with the saturation pressure by Magnus's formula (WMO
    guide no. 8). The viscosity is that of dry air by Sutherland's formula: 17.16 uPa s at 0 degrees Celsius,
    with 110.4 K.
    """
    t_k = temperature_c + _ZERO_C_K
    vapour_pa = 0.01 * humidity_percent * 611.2 * exp(17.62 * temperature_c / (243.12 + temperature_c))
    dry_air_pa = pressure_pa - vapour_pa
    density = dry_air_pa / (_DRY_AIR_J_PER_KG_K * t_k) + vapour_pa / (_VAPOUR_J_PER_KG_K * t_k)
    viscosity = 17.16e-6 * (t_k / _ZERO_C_K) ** 1.5 * (_ZERO_C_K + 110.4) / (t_k + 110.4)
    return Air(density, viscosity)


@dataclass(frozen=True, slots=True, kw_only=True)
class AmbientConditions:
    """Air and history of a run's contact; NaN for a quantity that is neither measured nor stated.

    The air is the mean of sensor readings during the run, otherwise as stated.
    """

    temperature_c: Annotated[float, Quantity("temperature", "temperature")] = nan
    humidity_percent: Annotated[float, Quantity("humidity", "relative humidity")] = nan
    pressure_pa: Annotated[float, Quantity("pressure", "pressure of the air", "hPa")] = nan
    dwell_s: Annotated[float, Quantity("dwell", "dwell of the ball on its place", "h")] = nan
    """Time from placing the ball to the run's first frame."""
    temperature_change_k: Annotated[
        float, Quantity("temperature change", "change of the temperature over the run", "K")
    ] = nan
    """Change over the run, by a straight line through the readings, if they span half of it."""
    age_s: Annotated[float, Quantity("age", "age of the surfaces since cleaning", "h")] = nan
    """Time from the last cleaning of the surfaces to the run's first frame."""

    def known(self) -> dict[str, float]:
        """Quantities that are known, by name."""
        return {name: value for name, value in asdict(self).items() if isfinite(value)}


_MAX_FRACTION = 1.0
"""Humidity in per cent up to which a fraction may have been meant: air in a room is never as dry."""
_MAX_RATIO = 30.0
"""Ratio to other runs beyond which a value is probably in another unit: it is 100 for fractions and hPa."""


def doubtful_humidity(percent: float) -> str:
    """Warning that a humidity may be a fraction; empty if it is plausible."""
    if not 0.0 < percent <= _MAX_FRACTION:
        return ""
    return (
        f"humidity_percent is {percent:g}, drier than air outside a dry box: if a fraction was meant, "
        f"state humidity_percent = {100 * percent:g}"
    )


def other_unit_warning(name: str, values: Mapping[str, float]) -> str:
    """Warning of runs, by label, whose humidity or pressure is in another unit than others'; else empty."""
    positive = sorted(value for value in values.values() if isfinite(value) and value > 0)
    if name not in ("humidity_percent", "pressure_pa") or len(positive) < 3:
        return ""
    median = positive[len(positive) // 2]
    outliers = {
        label: value
        for label, value in values.items()
        if value > 0 and not median / _MAX_RATIO < value < median * _MAX_RATIO
    }
    others = [value for label, value in values.items() if label not in outliers and isfinite(value)]
    if not outliers or 2 * len(outliers) >= len(positive):
        return ""
    outliers_text = ", ".join(f"{value:g} of {label}" for label, value in outliers.items())
    return (
        f"{name} is {outliers_text}, and {min(others):g} to {max(others):g} of the other runs: is it in "
        "another unit (a fraction, hPa)? As it stands it stretches the span of all dependences on it; "
        f"correct environment.{name} and fit that run again"
    )
