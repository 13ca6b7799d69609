"""Balance of the pendulum, estimated from its swings, and advice on which adjustment weight to turn."""

from processing.balance.advice import WeightResponses
from processing.balance.balance import (
    Balance,
    BalanceCheck,
    BalanceLimits,
    Doubt,
    Room,
    Turn,
    Unreachable,
    balance_checks,
    implausible,
    mass_centre_height_m,
    names_with_units,
)
from processing.balance.estimate import BalanceEstimator
from processing.balance.plane import PlaneOfSwing, balance_of_run, plane_of_swing, rotate, square_axes
