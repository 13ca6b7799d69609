"""What planned runs are said to tell of a contact that ages."""

from dataclasses import replace

import numpy as np
import pytest

from processing.contact import AMPLITUDE, LAWS, TIME
from processing.fit import Conditions, PlannedSeries, planned_run, planned_series
from processing.fit.exact_model import ExactModel
from processing.fit.ground import Noise
from processing.fit.planning import relative_jacobian, series_jacobian
from tests.processing.fit.decays import ARCSEC, paper_pair, truth, with_noise
from tests.processing.fit.driven import World, changing_path

PARAMETERS, PENDULUM = paper_pair("glass_k8")
NAMES = LAWS["paper"].names()
VALUES = dict(zip(NAMES, truth(PARAMETERS, NAMES), strict=True))
CONDITIONS = Conditions(0.005 * ARCSEC, 0.005 * ARCSEC * 4.071 / (2 * np.pi), 1e-9)
LONG = (124 * ARCSEC, 30 * ARCSEC)


def planned(
    spans: list[tuple[float, float]], wait_s: float = 0.0, conditions: Conditions = CONDITIONS
) -> PlannedSeries:
    """Runs of glass between these amplitudes."""
    return planned_series([planned_run(VALUES, PENDULUM, conditions, *span) for span in spans], wait_s)


def test_one_run_is_planned_as_ever_and_does_not_tell_its_age() -> None:
    run = planned_run(VALUES, PENDULUM, CONDITIONS, *LONG)
    one = planned([LONG])
    assert one.duration_s == pytest.approx(run.duration_s)
    for name, u in one.u_steady.items():
        assert u == pytest.approx(run.u[name], rel=0.02)
    assert one.u["b"] > 3 * one.u_steady["b"]


def test_waiting_and_another_first_amplitude_tell_it() -> None:
    one = planned([LONG])
    again = planned([LONG, LONG])
    waited = planned([LONG, LONG], 3600.0)
    other = planned([LONG, (60 * ARCSEC, 30 * ARCSEC)])
    assert waited.duration_s == pytest.approx(2 * one.duration_s + 3600.0)
    assert waited.u_ageing_per_s < again.u_ageing_per_s < 0.2 * one.u_ageing_per_s
    assert other.u_ageing_per_s < 0.2 * one.u_ageing_per_s
    for series in (again, waited, other):
        assert series.u["b"] < 1.2 * series.u_steady["b"]


def test_the_age_between_two_runs_is_seen_as_well_as_their_friction() -> None:
    """Long apart, with all else known, the growth is the difference of two frictions."""
    wait_s = 1e6
    apart = planned([LONG, LONG], wait_s)
    later = planned([LONG, LONG], 2 * wait_s)
    assert later.u_ageing_per_s == pytest.approx(apart.u_ageing_per_s / 2, rel=0.01)


@pytest.mark.slow
def test_the_age_of_integrated_runs_is_found_within_its_uncertainty() -> None:
    """Two runs of a contact that grows by 0.2 % from the first turning point to the last, an hour between."""
    still, turn, _ = changing_path(PARAMETERS, PENDULUM, World(), q=0.0, seed=1)
    lasting_s, wait_s, growth = float(still[-1]), 3600.0, 0.002
    whole_s = 2 * lasting_s + wait_s
    first, last = float(np.abs(turn[0])), float(np.abs(turn[-1]))
    still_ground = replace(CONDITIONS, ground_rad_per_s2_rthz=0.0)
    series = planned([(first, last)] * 2, wait_s, still_ground)
    u = series.u_ageing_per_s * whole_s
    assert u < 0.1 * growth
    paths = []
    for place in (-1, 1):
        later = growth * place * 0.5 * (lasting_s + wait_s) / whole_s
        aged = replace(PARAMETERS, b=PARAMETERS.b * (1 + later), c=PARAMETERS.c * (1 + later))
        world = World(ageing=growth * lasting_s / whole_s, lasting_s=lasting_s)
        paths.append(changing_path(aged, PENDULUM, world, q=0.0, seed=1))
    pulls = []
    for seed in range(20):
        runs, residuals = [], []
        for place, (time, turns, _) in enumerate(paths):
            rng = np.random.default_rng([seed, place, 34])
            points = with_noise(time, np.abs(turns), PARAMETERS.period0_s, 0.005, rng)
            model = ExactModel(points, PENDULUM)
            values = {**VALUES, AMPLITUDE.key: first, TIME.key: 0.0}
            columns, noise = model.columns.from_physical(values), Noise(step=0.0)
            rows = relative_jacobian(model, columns, values, noise)
            runs.append((rows, float(points.time_s[-1] - points.time_s[0])))
            residuals.append(model.on_ground(columns, noise)(columns)[0])
        stacked = series_jacobian(list(series.runs[0].values), runs, wait_s)
        change = -np.linalg.lstsq(stacked, np.concatenate(residuals), rcond=1e-13)[0]
        pulls.append((change[len(series.u)] - growth) / u)
    # the mean of 20 is known to 0.22, their scatter to 16 %
    assert abs(np.mean(pulls)) < 0.66
    assert 0.6 < np.std(pulls) < 1.4
