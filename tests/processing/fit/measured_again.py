"""Decays in rad with noise, and their half-cycles determined again with the fitted motion."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from processing.contact.law import ContactParameters, PendulumOnBall
from processing.deflections import Deflections, slow_deflections
from processing.fit.exact import fit_exact
from processing.fit.refinement import known_motion, second_measurement
from processing.swing import HalfCycle, turning_points
from tests.processing.swing.truth import BALL_RADIUS_M, CONTACTS, GRAVITY, MASS_KG, PX_PER_RAD, Record

NOISE_RAD = 0.02 / PX_PER_RAD


def contact_truth(contact: str) -> tuple[ContactParameters, PendulumOnBall]:
    """What `contact_decay` swings by."""
    b, p, c, n, period0_s, gamma, radius = CONTACTS[contact]
    return ContactParameters(b, p, c, n, period0_s, gamma), PendulumOnBall(
        MASS_KG, BALL_RADIUS_M, radius, GRAVITY
    )


def in_rad(record: Record) -> Record:
    """A record in px as one in rad."""
    return Record(
        record.times_ns,
        record.deflection / PX_PER_RAD,
        record.u_deflection / PX_PER_RAD,
        record.turn_time_s,
        record.turn_amplitude / PX_PER_RAD,
    )


def noisy(clean: Record, seed: int) -> Record:
    """A record in rad with noise of 0.02 px."""
    rng = np.random.default_rng([seed, 404])
    n = len(clean.deflection)
    return replace(
        clean,
        deflection=clean.deflection + NOISE_RAD * rng.standard_normal(n),
        u_deflection=np.full(n, NOISE_RAD),
    )


def again_with_fit(record: Record, swings: list[HalfCycle], contact: str) -> list[HalfCycle]:
    """The same swings, measured again on the motion of the exact fit to them."""
    pendulum = contact_truth(contact)[1]
    exact = fit_exact(turning_points(swings), pendulum)
    motion = known_motion(exact.parameters, pendulum, swings[0].amplitude)
    return second_measurement(swings, in_blocks(record), motion)


def in_blocks(record: Record) -> Iterator[Deflections]:
    """The samples of a record, 1,000 at a time."""
    for first in range(0, len(record.times_ns), 1000):
        part = slice(first, first + 1000)
        yield slow_deflections(record.times_ns[part], record.deflection[part], record.u_deflection[part])
