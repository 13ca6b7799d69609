"""What planned runs are said to tell of a contact that ages."""

import numpy as np
import pytest

from processing.contact import LAWS
from processing.fit import Conditions, planned_run, planned_series
from tests.processing.fit.decays import ARCSEC, paper_pair, truth

PARAMETERS, PENDULUM = paper_pair("glass_k8")
NAMES = LAWS["paper"].names()
VALUES = dict(zip(NAMES, truth(PARAMETERS, NAMES), strict=True))
CONDITIONS = Conditions(0.005 * ARCSEC, 0.005 * ARCSEC * 4.071 / (2 * np.pi), 1e-9)
LONG = (124 * ARCSEC, 30 * ARCSEC)


def test_one_run_is_planned_as_ever_and_does_not_tell_its_age() -> None:
    run = planned_run(VALUES, PENDULUM, CONDITIONS, *LONG)
    one = planned_series(VALUES, PENDULUM, CONDITIONS, [LONG])
    assert one.duration_s == pytest.approx(run.duration_s)
    for name, u in one.u_steady.items():
        assert u == pytest.approx(run.u[name], rel=0.02)
    assert one.u["b"] > 3 * one.u_steady["b"]


def test_waiting_and_another_first_amplitude_tell_it() -> None:
    one = planned_series(VALUES, PENDULUM, CONDITIONS, [LONG])
    again = planned_series(VALUES, PENDULUM, CONDITIONS, [LONG, LONG])
    waited = planned_series(VALUES, PENDULUM, CONDITIONS, [LONG, LONG], 3600.0)
    other = planned_series(VALUES, PENDULUM, CONDITIONS, [LONG, (60 * ARCSEC, 30 * ARCSEC)])
    assert waited.duration_s == pytest.approx(2 * one.duration_s + 3600.0)
    assert waited.u_ageing_per_s < again.u_ageing_per_s < 0.2 * one.u_ageing_per_s
    assert other.u_ageing_per_s < 0.2 * one.u_ageing_per_s
    for series in (again, waited, other):
        assert series.u["b"] < 1.2 * series.u_steady["b"]


def test_the_age_between_two_runs_is_seen_as_well_as_their_friction() -> None:
    """Long apart, with all else known, the growth is the difference of two frictions."""
    wait_s = 1e6
    apart = planned_series(VALUES, PENDULUM, CONDITIONS, [LONG, LONG], wait_s)
    later = planned_series(VALUES, PENDULUM, CONDITIONS, [LONG, LONG], 2 * wait_s)
    assert later.u_ageing_per_s == pytest.approx(apart.u_ageing_per_s / 2, rel=0.01)
