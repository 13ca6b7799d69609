"""Balance of the pendulum, estimated from its swings, and advice on which adjustment weight to turn."""

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
