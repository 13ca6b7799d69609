"""The pendulum's tilt, in its own axes."""

from typing import NamedTuple


class Deflection(NamedTuple):
    """Tilt of the pendulum at one moment.

    `y_rad` is the slow mode's (V axis, the paper's Y(t)), `x_rad` the fast mode's (U axis, X(t));
    `u_` are standard uncertainties. NaN where the spot was lost.
    """

    time_ns: int
    x_rad: float
    y_rad: float
    u_x_rad: float
    u_y_rad: float
