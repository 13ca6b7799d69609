"""Section [balance]: limits, properties of the pendulum, and the trimming weights with their threads."""

from pydantic import BaseModel, ConfigDict, Field
from pydantic.dataclasses import dataclass

from processing.balance import BalanceLimits


class WeightSettings(BaseModel, frozen=True, extra="forbid"):
    """A trimming weight on a screw. `sense` -1: a clockwise turn moves it in the negative direction.

    `mass_kg` 0 means that the mass is unknown.
    """

    mass_kg: float = Field(default=0.002, ge=0)
    pitch_m: float = Field(default=0.5e-3, gt=0, description="pitch of the thread")
    sense: int = Field(default=1, ge=-1, le=1)


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class BalanceSettings(BalanceLimits):
    """Balancing: limits, and properties of the weights. `rig balance` learns the effect of a turn."""

    seconds: float = Field(default=14.0, gt=9, description="length of one measurement, about three periods")
    inertia_kg_m2: float | None = Field(
        default=None, gt=0, description="about the contact; if left out, the height is not computed"
    )
    u_effect: float = Field(
        default=1.0,
        gt=0,
        le=2,
        description="relative uncertainty of the effect of a turn as computed from mass and thread; at 1 a "
        "weight may be three times as strong or stand across; 0.2 if the drawing is trusted",
    )
    gamma_pa: float = Field(
        default=0.0, ge=0, description="elastic adhesion, to compute T0 from T; 0: T0 = T"
    )
    n: float = Field(default=0.1, ge=0)
    weight_x: WeightSettings = WeightSettings()
    weight_y: WeightSettings = WeightSettings()
    weight_height: WeightSettings = WeightSettings(mass_kg=0.005, pitch_m=0.7e-3)
