"""The motion of the ground that a pendulum's drive corresponds to."""

import math

import numpy as np

from processing.estimate import Estimate
from processing.fit import BaseMotion
from processing.noise_models import nlnm_db
from rig.settings import PendulumSettings


def base_motion(
    drive: Estimate, upper_95: float, period_s: float, pendulum: PendulumSettings | None
) -> BaseMotion | None:
    """Base acceleration for the stated height of the mass centre; None where none is stated.

    A base acceleration a drives the pendulum with ``w^2 d/(g R) a``, d the height of its mass centre over the
    point of contact. `drive` and its bound `upper_95` are in rad/s^2/sqrt(Hz).
    """
    if pendulum is None or not pendulum.mass_centre_height_m:
        return None
    per_drive = (
        pendulum.gravity_m_per_s2
        * pendulum.ball_radius_m
        * (period_s / (2 * math.pi)) ** 2
        / abs(pendulum.mass_centre_height_m)
    )
    found = Estimate(drive.value * per_drive, drive.standard_uncertainty * per_drive)
    low_db = float(nlnm_db(np.array([1 / period_s]))[0])
    return BaseMotion(
        mass_centre_height_m=pendulum.mass_centre_height_m,
        acceleration_m_per_s2_rthz=found,
        upper_95=upper_95 * per_drive,
        above_low_noise_model_db=20 * math.log10(found.value) - low_db if found.value > 0 else math.nan,
    )
