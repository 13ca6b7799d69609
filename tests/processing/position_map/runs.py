"""A short run of the paper's glass pair with an error of place in its deflections."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from processing.contact import ContactParameters, PendulumOnBall
from processing.deflections import Deflections, slow_deflections
from processing.fit import fit_exact, known_motion
from processing.position_map import PositionMap, PositionMapSearch
from processing.swing import CycleExtractor, HalfCycle, half_cycles_of_blocks, turning_points
from processing.units import ARCSEC_RAD
from tests.processing.fit.decays import paper_pair
from tests.processing.fit.driven import driven_path

Floats = NDArray[np.float64]

PX = 0.5 * ARCSEC_RAD
NOISE = 0.006 * PX
RATE = 50.0


class Run(NamedTuple):
    half_cycles: list[HalfCycle]
    deflections: Deflections
    parameters: ContactParameters
    pendulum: PendulumOnBall


@cache
def _path() -> tuple[ContactParameters, PendulumOnBall, Floats]:
    parameters, pendulum = paper_pair("glass_k8")
    path = driven_path(parameters, pendulum, q=0.0, seed=1, last_arcsec=95.0, frames_per_s=RATE)[2]
    return parameters, pendulum, path


def nothing(time_s: Floats, place: Floats) -> Floats:
    return np.zeros(len(place))


def fringes(time_s: Floats, place: Floats) -> Floats:
    """What fringes of 1 % and a period of 40 px do to a Gaussian spot with a sigma of 6 px."""
    return 0.035 * PX * np.sin(2 * np.pi * place / (40 * PX) + 1.0)


def run(
    added: Callable[[Floats, Floats], Floats],
    seed: int,
    fast: Callable[[Floats], Floats] | None = None,
) -> Run:
    """`added` to the true deflections are errors (time, place); `fast` is what the fast axis shows."""
    parameters, pendulum, path = _path()
    rng = np.random.default_rng([seed, 31])
    time_s = np.arange(len(path)) / RATE
    times_ns = np.rint(time_s * 1e9).astype(np.int64)
    y = path + added(time_s, path) + NOISE * rng.standard_normal(len(path))
    deflections = slow_deflections(times_ns, y, NOISE)
    if fast is not None:
        x = fast(time_s) + NOISE * rng.standard_normal(len(path))
        deflections = replace(deflections, x=x, u_x=deflections.u_y)
    return Run(half_cycles_of_blocks([deflections]), deflections, parameters, pendulum)


def searched(one: Run) -> PositionMap | None:
    """The map that a run gives."""
    fit = fit_exact(turning_points(one.half_cycles), one.pendulum)
    motion = known_motion(fit.parameters, one.pendulum, one.half_cycles[0].amplitude)
    watch = CycleExtractor(one.half_cycles, motion)
    y = one.deflections.y
    search = PositionMapSearch(float(y.min()), float(y.max()), watch.pending_cycles)
    for start in range(0, len(one.deflections), 1000):
        for cycle in watch.update(one.deflections[start : start + 1000]):
            search.add(cycle)
    return search.position_map()
