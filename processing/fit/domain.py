"""Whether a law was fitted where it holds: angles against the contact's, and signs that cannot be."""

from processing.contact import PendulumOnBall
from processing.fit.result import FitResult
from processing.number_text import plain
from processing.swing import TurningPoints

_SMALL_RAD = 0.03
"""Amplitude up to which gravity's moment is taken as proportional: A^2/16 of the period is 6e-5 there."""
_SIGNIFICANT = 3.0
"""Standard uncertainties below nought from which on a sign is a wrong one."""


def domain_warnings(
    points: TurningPoints, pendulum: PendulumOnBall | None, fit: FitResult
) -> tuple[str, ...]:
    """What is said of a fit outside of the range in which its law has a meaning.

    A ball that rolls by more than the radius of its contact has left the spot on which it stood, and with it
    what Eqs. 1 and 3 are about; beyond pi/2 of it the moment of Eq. 3 has the other sign.
    """
    if pendulum is None:
        return ()
    found = []
    first_rad = float(points.amplitude[0])
    contact_rad = pendulum.contact_radius_m / pendulum.ball_radius_m
    if first_rad > contact_rad:
        found.append(
            f"the first amplitude, {plain(first_rad, 3)} rad, is {plain(first_rad / contact_rad, 3)} times "
            f"the contact's angle a/R = {plain(contact_rad, 3)} rad: the laws of the contact hold only below "
            "it; start lower, or check lever and unit of the angles"
        )
    if first_rad > _SMALL_RAD:
        found.append(
            f"the first amplitude, {plain(first_rad, 3)} rad, is not a small angle: gravity alone lengthens "
            f"the period by {plain(first_rad**2 / 16, 1)} there, which the laws neglect; start below "
            f"{_SMALL_RAD:g} rad"
        )
    for name, below in impossible(fit).items():
        found.append(
            f"{name} = {plain(fit.estimate(name).value, 3)} is negative by {plain(below, 2)} u, which it "
            "cannot be: the law is not that of this motion"
        )
    return tuple(found)


def impossible(fit: FitResult) -> dict[str, float]:
    """By how many standard uncertainties parameters lie below zero that cannot, where it is no chance."""
    found = {}
    for name in fit.contact_names:
        value, u = fit.estimate(name)
        if fit.law.parameter(name).lower == 0 and value < -_SIGNIFICANT * u:
            found[name] = -value / u
    return found
