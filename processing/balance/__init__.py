"""Balance of the pendulum from its swings: what is wrong with it, and which weight to turn."""

from processing.balance.advice import (
    BalanceLimits,
    Fault,
    Turn,
    WeightResponses,
    find_faults,
    mass_centre_height_m,
)
from processing.balance.estimate import Balance, BalanceEstimator

__all__ = [
    "Balance",
    "BalanceEstimator",
    "BalanceLimits",
    "Fault",
    "Turn",
    "WeightResponses",
    "find_faults",
    "mass_centre_height_m",
]
