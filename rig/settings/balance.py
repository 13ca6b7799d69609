"""[balance]: limits, properties of the pendulum, and the trimming weights with their threads."""

from pydantic import BaseModel, ConfigDict, Field
from pydantic.dataclasses import dataclass

from processing.balance import BalanceLimits


class WeightSettings(BaseModel, frozen=True, extra="forbid"):
    """A weight on a screw. `sense` -1: a clockwise turn carries it the negative way; mass 0: not known."""

    mass_kg: float = Field(default=0.002, ge=0)
    pitch_m: float = Field(default=0.5e-3, gt=0, description="of the thread, a turn")
    sense: int = Field(default=1, ge=-1, le=1)


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class BalanceSettings(BalanceLimits):
    """Balancing: the limits, and what is known of pendulum and weights. The effect of a turn is learned."""

    seconds: float = Field(default=14.0, gt=9, description="of swinging for one look; three periods")
    inertia_kg_m2: float | None = Field(
        default=None, gt=0, description="about the contact; None: the height is not computed"
    )
    gamma_pa: float = Field(default=0.0, ge=0, description="elastic adhesion, for T0 from T; 0: T is taken")
    n: float = Field(default=0.1, ge=0)
    weight_x: WeightSettings = WeightSettings()
    weight_y: WeightSettings = WeightSettings()
    weight_height: WeightSettings = WeightSettings(mass_kg=0.005, pitch_m=0.7e-3)
