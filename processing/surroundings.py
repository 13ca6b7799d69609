"""What surrounded a run: the air, and how long the contact and its surfaces had been as they were."""

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
