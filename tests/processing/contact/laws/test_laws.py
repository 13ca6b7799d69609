"""All laws of the registry are consistent; one is fitted like any other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from processing.contact import AMPLITUDE, LAWS, TIME, Law
from processing.contact.asymptotic import DecayStart, PeriodStart, StartValues
from processing.contact.laws.paper import _propose_starts
from processing.fit import fit_exact, identifiability
from tests.processing.contact.laws.branches import constant_decay
from tests.processing.fit.decays import ARCSEC, decay, paper_pair

_C, _PERIOD_S, _FIRST, _U_ARCSEC = 0.1 * ARCSEC, 4.05, 124 * ARCSEC, 0.005


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_a_law_says_what_people_need(law: Law) -> None:
    assert law.title
    assert law.source
    assert len(set(law.names())) == len(law.parameters)
    assert law.parameter("period0_s") in law.parameters
    for parameter in law.parameters:
        assert all((parameter.symbol, parameter.unit, parameter.description, parameter.source))
        assert parameter.lower < parameter.upper
    beside = () if "drag_s" in law.names() else ("drag_s",)
    assert law.fit_names(drag=True) == (*law.names(), *beside, AMPLITUDE.key, TIME.key)


@pytest.mark.parametrize("drag", [False, True])
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_columns_stand_for_the_physical_values_and_back(law: Law, drag: bool) -> None:
    parameters, pendulum = paper_pair("steel", 1e-4)
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=5, last_arcsec=40)
    names = law.fit_names(drag=drag)
    columns = law.coordinates(points, pendulum, names)
    start = columns.starts(points)[0][0]
    values = dict(zip(names, columns.physical(start)[0].tolist(), strict=True))
    np.testing.assert_allclose(columns.from_physical(values), start, rtol=1e-9)
    sizes = np.maximum(np.abs(start), 0.1)
    for conversion in (columns.physical, columns.map_parameters):
        value, by_columns = conversion(start)
        for k, step in enumerate(np.diag(1e-6 * sizes)):
            slope = (conversion(start + step)[0] - conversion(start - step)[0]) / (2 * step[k])
            scale = np.maximum(np.abs(value), np.abs(by_columns[:, k] * sizes[k])) + 1e-300
            np.testing.assert_allclose((slope - by_columns[:, k]) * sizes[k] / scale, 0.0, atol=1e-6)


def test_a_law_other_than_the_papers_is_fitted() -> None:
    law, pulls = LAWS["constant"], []
    for seed in range(4):
        points = constant_decay(_C, _PERIOD_S, _FIRST, 500, _U_ARCSEC, seed)
        result = fit_exact(points, paper_pair("steel")[1], law=law)
        assert result.law is law
        assert result.names == ("c", "period0_s", AMPLITUDE.key, TIME.key)
        assert 0.8 < result.chi2_per_dof < 1.2
        assert result.warnings == ()
        truth = np.array([_C, _PERIOD_S, _FIRST, 0.25])
        pulls.append((result.values - truth) / result.standard_uncertainty)
    assert np.all(np.abs(np.mean(pulls, axis=0)) < 4 / np.sqrt(4))
    # at rest uncertainties also hold the drives that a run cannot exclude
    assert np.all((np.std(pulls, axis=0) > 0.2) & (np.std(pulls, axis=0) < 1.6))


def test_its_parameters_are_judged_like_any_other() -> None:
    points = constant_decay(_C / 1000, _PERIOD_S, _FIRST, 40, 100 * _U_ARCSEC, 3)
    pendulum = paper_pair("steel")[1]
    result = fit_exact(points, pendulum, law=LAWS["constant"])
    verdicts = {item.name: item for item in identifiability(points, pendulum, result)}
    assert verdicts["c"].verdict == "upper bound"
    assert verdicts["c"].lower_95 == 0.0
    assert verdicts["c"].upper_95 > _C / 1000
    assert verdicts["period0_s"].verdict == "determined"


@pytest.mark.parametrize("p", [0.4, 1.3])
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_fits_start_within_the_range_of_their_law(law: Law, p: float) -> None:
    """Also where friction falls faster with the amplitude than any law of memory allows."""
    parameters, pendulum = paper_pair("steel")
    strong = replace(parameters, p=p, b=parameters.b * (124 * ARCSEC) ** (parameters.p - p))
    points = decay(strong, pendulum, noise_arcsec=0.005, seed=1)
    columns = law.coordinates(points, pendulum, law.fit_names())
    starts = [attempts[0] for attempts in columns.starts(points)]
    assert starts
    for start in starts:
        values = dict(zip(law.fit_names(), columns.physical(start)[0].tolist(), strict=True))
        for name, value in values.items():
            assert law.parameter(name).lower <= value <= law.parameter(name).upper, name


def test_starts_of_the_papers_law_are_in_terms_of_gravity_s_stiffness() -> None:
    """Rates are those of Eq. 5 times (T0/T)^2; T0 and kappa give Eq. 6's period and slope at x = 1."""
    decay_of_eq5 = DecayStart(1.0, 0.02, 0.9, 0.01, 0.003)
    worse = [PeriodStart(4.1, n, -0.01) for n in (1.0, 1.4)]
    periods = [PeriodStart(4.4, 0.6, 0.07), *worse, PeriodStart(4.2, 2.0, -0.1), PeriodStart(4.3, 0.3, 0.1)]
    stiff, *_, plain = _propose_starts(StartValues(decay_of_eq5, periods, 4.0), 0.0)
    j = quad(lambda angle: np.cos(angle) ** 2.6, 0.0, np.pi / 2)[0]

    def eq6(x: float) -> float:
        return 4.4 / (1 - 0.07 * j * x**0.6)

    def balanced(x: float) -> float:
        return stiff["period0_s"] / np.sqrt(1 - 2 * stiff["gamma_pa"] * j * x**0.6)

    assert balanced(1.0) == pytest.approx(eq6(1.0))
    assert balanced(1.001) - balanced(0.999) == pytest.approx(eq6(1.001) - eq6(0.999), rel=1e-5)
    factor = (stiff["period0_s"] / 4.0) ** 2
    common = {"p": 0.9, "drag_s": 0.012 / np.pi}
    assert stiff == pytest.approx({**stiff, **common, "b": 0.02 * factor, "c": 0.01 * factor, "n": 0.6})
    assert plain == pytest.approx(
        {**common, "b": 0.02, "c": 0.01, "n": 0.5, "gamma_pa": 0.0, "period0_s": 4.0}
    )
    # the first with a positive gamma is tried, however badly it fits the periods
    only_last = StartValues(decay_of_eq5, periods[1:], 4.0)
    assert [values["n"] for values in _propose_starts(only_last, 0.0)] == [1.0, 1.4, 2.0, 0.3, 0.5]
