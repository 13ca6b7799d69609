"""Results as they are reported, where the plane turns, and of tables that are hard to judge.

Run as ``python -m tests.benchmarks reported [--quick]``. The turning decays of 600 s come from the simulated
rig's own integration, turned in both directions, as deflections of a record and as a table of two positions;
also with a fast mode of 6 arcsec and a leakage of 3 %. Those of hard tables (short runs, a contact that ages,
times that jitter) come from the tests' own integration, on quiet ground and in air, and are fitted as
`rig fit TABLE` does. All are seen 25 times a second with 0.005 arcsec. Counted are values and 95 % intervals
that are shown; a parameter that is only bounded counts where its interval holds the truth.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from processing.deflections import Deflections, DeflectionUnit
from tests.benchmarks.cases import run_of
from tests.benchmarks.coverage import FRAMES_PER_S, NOISE_ARCSEC, Case, measure, truth_of
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import World, changing_path
from tests.rig.analysis.spinning import (
    DEG_PER_MIN,
    Held,
    Spin,
    analysed,
    analysed_table,
    configuration,
    held_by,
    positions,
)

RATES_DEG_PER_MIN = (0.0, 0.2, -0.2, 1.0, -1.0, 3.0, -3.0)
PARAMETERS, PENDULUM = paper_pair("glass_k8", 1.7e-3)


def turning() -> list[Case]:
    """Of a record or a table; in the latter leakage is part of its direction, along which angles are true."""

    def case(way: str, rate_deg_per_min: float, disturbed: bool) -> Case:
        rate = rate_deg_per_min * DEG_PER_MIN
        spin = Spin(rate, leakage=0.03, fast_arcsec=6.0) if disturbed else Spin(rate)

        def found(seed: int) -> Mapping[str, Held] | None:
            seen, config = positions(spin, seed + 1), configuration()
            assert config.simulation is not None
            true = {name: float(getattr(config.simulation.contact, name)) for name in truth_of(PARAMETERS)}
            with TemporaryDirectory() as name:
                if way == "table":
                    length = float(np.hypot(1.0, spin.leakage))
                    seen = replace(seen, x=seen.x / length, y=seen.y / length)
                    config = config.model_copy(update={"lever": None, "axes": None})
                    run = analysed_table(seen, config, Path(name) / "t.csv")
                else:
                    run = analysed(seen, config, Path(name) / "run-1.mcap")
            if run.problem.startswith("withheld"):
                return None
            lines = {name: run.budget[name] for name in true}
            pulls = {name: (one.value - true[name]) / one.standard_uncertainty for name, one in lines.items()}
            return {name: held_by(run, name, true[name])._replace(pull=pull) for name, pull in pulls.items()}

        beside = ", fast mode 6 arcsec, leakage 3 %" if disturbed else ""
        return Case(f"{way} turning by {rate_deg_per_min:+g} deg/min{beside}", found)

    return [
        case(way, rate, disturbed)
        for disturbed in (False, True)
        for way in ("record", "table")
        for rate in RATES_DEG_PER_MIN
    ]


def table(world: World, seed: int, lasting_s: float, jitter_s: float) -> Deflections:
    """Positions at the times at which they were taken, under the times that are stated."""
    path = changing_path(PARAMETERS, PENDULUM, world, q=1e-9, seed=seed)[2][: round(lasting_s * FRAMES_PER_S)]
    random = np.random.default_rng([seed, 79])
    times_s = np.arange(len(path)) / FRAMES_PER_S + jitter_s * random.standard_normal(len(path))
    x = path + NOISE_ARCSEC * ARCSEC * random.standard_normal(len(path))
    y = NOISE_ARCSEC * ARCSEC * random.standard_normal(len(path))
    u = np.full(len(path), NOISE_ARCSEC * ARCSEC)
    times_ns = np.rint((times_s - times_s.min()) * 1e9).astype(np.int64)
    return Deflections(times_ns, x, y, u, u, DeflectionUnit.RAD)


def hard_tables() -> list[Case]:
    """Short, ageing, jittering; `stated` is what the configuration says of it."""

    def case(
        name: str,
        world: World = World(),  # noqa: B008
        lasting_s: float = 600.0,
        jitter_s: float = 0.0,
        stated: str = "",
    ) -> Case:
        true = truth_of(PARAMETERS)

        def found(seed: int) -> Mapping[str, Held] | None:
            config = configuration(*stated.split()).model_copy(update={"lever": None, "axes": None})
            with TemporaryDirectory() as folder:
                seen = table(world, seed, lasting_s, jitter_s)
                run = analysed_table(seen, config, Path(folder) / "t.csv")
            return None if run.problem else {name: held_by(run, name, one) for name, one in true.items()}

        return Case(name, found)

    ageing, drifting = World(ageing=0.01, lasting_s=600.0), World(drag_drift=0.02, lasting_s=600.0)
    return [
        case("short: 75 s", lasting_s=75.0),
        case("short: 75 s, drag open", lasting_s=75.0, stated="fit.drag=open"),
        case("short: 150 s", lasting_s=150.0),
        case("ageing: b grows by 1 %", ageing, stated="fit.u_ageing=0.01"),
        case("ageing: drag drifts by 2 %", drifting, stated="fit.u_drag_drift=0.02"),
        case("jitter: 1 ms", jitter_s=1e-3),
    ]


run = run_of(measure, turning, hard_tables, seeds=20, quick_seeds=1)
