"""Balance of the pendulum, estimated from its swings, and advice on which adjustment weight to turn."""

from processing.balance.advice import (
    BalanceLimits,
    Fault,
    Turn,
    WeightResponses,
    find_faults,
    mass_centre_height_m,
)
from processing.balance.balance import Balance, InUnit, names_with_units
from processing.balance.estimate import BalanceEstimator

__all__ = [
    "Balance",
    "BalanceEstimator",
    "BalanceLimits",
    "Fault",
    "InUnit",
    "Turn",
    "WeightResponses",
    "find_faults",
    "mass_centre_height_m",
    "names_with_units",
]
