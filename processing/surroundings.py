"""What surrounded a run: the air, and how long the contact and its surfaces had been as they were."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isfinite, nan
from typing import Annotated

from processing.quantity import Quantity


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """Air and history of a run's contact; NaN for what is neither read nor stated.

    Air: mean sensor readings during the run, otherwise as stated. `temperature_change_k` is the change of
    temperature from the first reading to the last, by a straight line through them. `dwell_s` is the time
    from setting the ball on its place to the run's first frame, `age_s` that from the last cleaning of the
    surfaces.
    """

    temperature_c: Annotated[float, Quantity("temperature", "temperature")] = nan
    humidity_percent: Annotated[float, Quantity("humidity", "relative humidity")] = nan
    pressure_pa: Annotated[float, Quantity("pressure", "pressure of the air", "hPa")] = nan
    dwell_s: Annotated[float, Quantity("dwell", "dwell of the ball on its place", "h")] = nan
    temperature_change_k: Annotated[
        float, Quantity("temperature change", "change of the temperature over the run", "K")
    ] = nan
    age_s: Annotated[float, Quantity("age", "age of the surfaces since cleaning", "h")] = nan

    def known(self) -> dict[str, float]:
        """What is known, by name."""
        return {name: value for name, value in asdict(self).items() if isfinite(value)}


_IN_PERCENT = 1.0
"""Humidity in per cent up to which a fraction may have been meant: air in a room is never as dry."""
_OTHER_UNIT = 30.0
"""Ratio to the others beyond which a value is probably in another unit: 100 for fractions, and for hPa."""


def doubtful_humidity(percent: float) -> str:
    """What is to be asked of a humidity as stated or read; empty: nothing."""
    if not 0.0 < percent <= _IN_PERCENT:
        return ""
    return (
        f"humidity_percent is {percent:g}, drier than air outside a dry box: if a fraction was meant, "
        f"state humidity_percent = {100 * percent:g}"
    )


def in_other_unit(name: str, values: Mapping[str, float]) -> str:
    """What is to be said of runs, by label, whose humidity or pressure is in another unit than others'."""
    known = sorted(value for value in values.values() if isfinite(value) and value > 0)
    if name not in ("humidity_percent", "pressure_pa") or len(known) < 3:
        return ""
    middle = known[len(known) // 2]
    odd = {
        label: value
        for label, value in values.items()
        if value > 0 and not middle / _OTHER_UNIT < value < middle * _OTHER_UNIT
    }
    rest = [value for label, value in values.items() if label not in odd and isfinite(value)]
    if not odd or 2 * len(odd) >= len(known):
        return ""
    listed = ", ".join(f"{value:g} of {label}" for label, value in odd.items())
    return (
        f"{name} is {listed}, and {min(rest):g} to {max(rest):g} of the other runs: is it in another unit "
        "(a fraction, hPa)? As it stands it stretches the span of all dependences on it; correct "
        f"environment.{name} and fit that run again"
    )
