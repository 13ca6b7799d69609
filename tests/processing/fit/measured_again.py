"""Decays in rad with noise, and their half-cycles determined again with the fitted motion."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from processing.deflections import Deflections, slow_deflections
from processing.fit.exact import fit_exact
from processing.fit.refinement import known_motion, second_measurement
from processing.swing import HalfCycle, turning_points
from tests.processing.fit.decays import paper_pair
from tests.processing.swing.truth import PX_PER_RAD, Record

NOISE_RAD = 0.02 / PX_PER_RAD


def in_rad(record: Record) -> Record:
    """A record in px as one in rad."""
    in_px = ("deflection", "u_deflection", "turn_amplitude")
    return replace(record, **{name: getattr(record, name) / PX_PER_RAD for name in in_px})


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
    pendulum = paper_pair(contact)[1]
    exact = fit_exact(turning_points(swings), pendulum)
    motion = known_motion(exact.parameters, pendulum, swings[0].amplitude)
    return second_measurement(swings, in_blocks(record), motion)


def in_blocks(record: Record) -> Iterator[Deflections]:
    """The samples of a record, 1,000 at a time."""
    for first in range(0, len(record.times_ns), 1000):
        part = slice(first, first + 1000)
        yield slow_deflections(record.times_ns[part], record.deflection[part], record.u_deflection[part])
