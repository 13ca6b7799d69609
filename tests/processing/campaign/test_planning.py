"""Runs are chosen that reach a goal soonest, and what is expected of them is what comes out."""

from dataclasses import replace

import numpy as np
import pytest

from processing.campaign import (
    FRICTION,
    CampaignModel,
    CandidateRun,
    Effect,
    Form,
    Goal,
    Level,
    Outlook,
    choose_next,
    choose_runs,
    fit_campaign,
    ratio_against_nothing,
    ratio_between_forms,
)
from processing.errors import DataError
from tests.processing.campaign.simulated_decays import AIR_PER_S, NAMES, TRUTH, expected, measured

MODEL = CampaignModel(names=NAMES, sizes={"b": 0.01, "p": 0.002, "c": 0.1})
C = [Goal(limit=0.05, coordinates={"c": 1.0})]
B = [Goal(limit=0.005, coordinates={"b": 1.0})]
DURING = Effect(parameter=FRICTION, covariate="", form=Form.DURING)


def runs_between(
    *spans: tuple[float, float], contact: str = "sample", ready_s: float = 60.0
) -> list[CandidateRun]:
    return [CandidateRun(likelihood=expected(*span, contact=contact), ready_s=ready_s) for span in spans]


LONG, MIDDLE, SHORT = (124.0, 2.0), (60.0, 15.0), (124.0, 30.0)


def test_expected_uncertainty_is_what_a_fit_finds() -> None:
    """For a scatter that is known, up to the draws' own."""
    model = CampaignModel(names=NAMES, scatter=(), bad_run_chance=0.0)
    (one,) = runs_between(LONG)
    ahead = Outlook([], model, [one], [Goal(limit=1.0, coordinates={"c": 1.0})])
    whole = ahead.before + sum(ahead.adds(0, 0.0, place) for place in range(4))
    rng = np.random.default_rng(1)
    made = [
        measured(one.likelihood, np.array(TRUTH), 0.0, rng, truth=TRUTH, number=k, began_s=0.0)
        for k in range(4)
    ]
    found = fit_campaign(made, model, draws=4000).estimate(Level("contact", "c", "sample"))
    assert ahead.ratio(whole) == pytest.approx(found.standard_uncertainty, rel=0.05)


def test_what_was_measured_counts() -> None:
    (one,) = runs_between(LONG)
    rng = np.random.default_rng(2)
    made = [
        measured(one.likelihood, np.array(TRUTH), 0.0, rng, truth=TRUTH, number=k, began_s=0.0)
        for k in range(6)
    ]
    posterior = fit_campaign(made, MODEL)
    ahead = Outlook(made, MODEL, [one], [Goal(limit=1.0, coordinates={"c": 1.0})], posterior=posterior)
    u = posterior.estimate(Level("contact", "c", "sample")).standard_uncertainty
    assert ahead.ratio(ahead.before) == pytest.approx(u, rel=0.25)
    assert choose_runs(ahead).runs == ()


def test_short_runs_are_taken_for_what_they_tell_as_well() -> None:
    """Runs scatter in b more than a short one measures it: time is better spent on more of them."""
    ahead = Outlook([], MODEL, runs_between(LONG, MIDDLE), B)
    choice = choose_runs(ahead)
    assert choice.reached
    kinds = [one.candidate.label for one in choice.runs]
    assert kinds.count("60 to 15 arcsec") > kinds.count("124 to 2 arcsec")
    only_long = choose_runs(Outlook([], MODEL, runs_between(LONG), B))
    assert only_long.reached
    assert choice.rig_time_s < 0.7 * only_long.rig_time_s
    # c needs the end of the decay, which a short run does not see
    of_c = choose_runs(Outlook([], MODEL, runs_between(LONG, SHORT), C))
    assert all(one.candidate.label == "124 to 2 arcsec" for one in of_c.runs)


def test_every_run_brings_the_goal_nearer() -> None:
    choice = choose_runs(Outlook([], MODEL, runs_between(LONG, MIDDLE), [*B, *C]))
    assert choice.expected < 1 <= choice.runs[-1].before
    assert all(one.after < one.before for one in choice.runs)
    assert [one.before for one in choice.runs[1:]] == [one.after for one in choice.runs[:-1]]


def test_what_runs_share_cannot_be_measured_away() -> None:
    """The air moves b by 0.0013 in every run: no number of them knows it better."""
    choice = choose_runs(
        Outlook([], MODEL, runs_between(LONG, MIDDLE), [Goal(limit=1e-3, coordinates={"b": 1.0})])
    )
    assert choice.runs == ()
    assert not choice.reached
    assert 1.2 < choice.floor < 1.5


def test_limits_are_kept() -> None:
    ahead = Outlook([], MODEL, runs_between(LONG, MIDDLE), B)
    short = choose_runs(ahead, longest_s=1500.0)
    assert short.runs
    assert short.rig_time_s <= 1500.0
    assert not short.reached
    assert len(choose_runs(ahead, most=3).runs) <= 3


def test_samples_come_in_blocks_in_an_order_by_chance() -> None:
    candidates = [*runs_between(MIDDLE, contact="glass"), *runs_between(MIDDLE, contact="steel")]
    ahead = Outlook([], MODEL, candidates, B)
    choice = choose_runs(ahead, seed=3)
    assert choice.reached
    samples = [one.candidate.contact for one in choice.runs]
    assert len(samples) % 2 == 0
    blocks = [tuple(samples[k : k + 2]) for k in range(0, len(samples), 2)]
    assert {frozenset(block) for block in blocks} == {frozenset({"glass", "steel"})}
    assert len(set(blocks)) == 2
    again = [one.candidate.contact for one in choose_runs(ahead, seed=3).runs]
    assert again == samples


def test_growth_during_a_run_asks_for_other_amplitudes() -> None:
    """One kind of run takes it for an exponent, however many there are."""
    model = MODEL.with_effects(DURING)
    goal = [Goal(limit=0.005, effect=DURING)]
    alone = choose_runs(Outlook([], model, runs_between(LONG), goal))
    assert alone.runs == ()
    assert alone.floor > 1
    both = Outlook([], model, runs_between(LONG, MIDDLE, (30.0, 2.0)), goal)
    assert choose_runs(both, most=5).floor < 0.5


def test_waiting_is_chosen_where_a_contact_ages_at_rest() -> None:
    rest = Effect(parameter="b", covariate="dwell_s", form=Form.LOGARITHM, reference=600.0)
    goal = [Goal(limit=0.03 / ratio_against_nothing(0.95, 1 / 3), effect=rest)]
    at_once = CandidateRun(likelihood=expected(*MIDDLE), ready_s=60.0)
    waited = CandidateRun(
        likelihood=replace(expected(*MIDDLE), label="later"), waiting_s=3600.0, ready_s=60.0
    )
    choice = choose_runs(Outlook([], MODEL.with_effects(rest), [at_once, waited], goal))
    assert choice.reached
    kinds = [one.candidate.label for one in choice.runs]
    assert min(kinds.count("later"), kinds.count("60 to 15 arcsec")) >= 2


def test_age_counts_when_a_run_is_made() -> None:
    age = Effect(parameter="b", covariate="age_s", form=Form.LINEAR, reference=0.0)
    goal = [Goal(limit=0.01, effect=age)]
    waiting = [
        CandidateRun(likelihood=expected(*MIDDLE), waiting_s=waiting_s, ready_s=60.0)
        for waiting_s in (0.0, 7200.0)
    ]
    ahead = Outlook([], MODEL.with_effects(age), waiting, goal, horizon_s=36000.0)
    early = ahead.ratio(ahead.before + ahead.adds(0, 0.0, 0) + ahead.adds(0, 600.0, 1))
    late = ahead.ratio(ahead.before + ahead.adds(0, 0.0, 0) + ahead.adds(0, 30000.0, 1))
    assert late < 0.8 * early
    assert choose_runs(ahead).reached


def test_a_humidity_that_nobody_knows_cannot_be_planned_for() -> None:
    humid = Effect(parameter="c", covariate="humidity_percent", form=Form.LINEAR, reference=45.0)
    with pytest.raises(DataError, match="humidity_percent is known of 0 runs"):
        Outlook([], MODEL.with_effects(humid), runs_between(LONG), [Goal(limit=0.1, effect=humid)])


def test_the_chance_of_the_right_form() -> None:
    """Against draws of slopes, whose evidence is that of a normal prior."""
    rng = np.random.default_rng(5)
    for size in (0.5, 1.0, 3.0):
        u = 1 / ratio_against_nothing(0.95, size)
        q2 = (size / u) ** 2
        right = []
        for true in (0.0, 1.0):
            z = (true + u * rng.normal(size=40_000)) / u
            gain = 0.5 * z**2 * q2 / (1 + q2) - 0.5 * np.log1p(q2)
            right.append(np.mean((gain > 0) == (true > 0)))
        assert np.mean(right) == pytest.approx(0.95, abs=0.004)
    assert ratio_between_forms(0.95) == pytest.approx(3.29, abs=0.01)


def test_the_air_of_the_made_up_decays_is_one() -> None:
    """The generator's shared column is what its air does: the drag's error over all friction."""
    longer, shorter = expected(*LONG), expected(*MIDDLE)
    assert longer.shared["air"][0] == pytest.approx(4e-6 / 3e-3, rel=0.05)
    assert shorter.shared["air"][0] == pytest.approx(longer.shared["air"][0], rel=0.05)
    assert AIR_PER_S > 0


def test_who_learns_begins_with_runs_that_tell_how_they_scatter() -> None:
    """Two goals that two short runs just reach on average; precise ones reach them sooner where runs scatter
    little, which is seen after the first."""
    model = CampaignModel(names=NAMES, sizes={"b": 0.01, "p": 0.001, "c": 0.1})
    goals = [Goal(limit=0.01, coordinates={"b": 1.0}), Goal(limit=0.1, coordinates={"c": 1.0})]
    ahead = Outlook([], model, runs_between(LONG, (60.0, 2.0), (30.0, 2.0), ready_s=120.0), goals)
    fixed, first = choose_runs(ahead), choose_next(ahead)
    assert fixed.rig_time_s < first.rig_time_s
    assert first.runs[0].candidate.label == "124 to 2 arcsec"
    assert fixed.reached
    assert first.reached
    # where nothing scatters there is nothing to learn
    still = CampaignModel(names=NAMES, scatter=())
    ahead = Outlook([], still, runs_between(LONG, (60.0, 2.0), (30.0, 2.0)), goals)
    assert choose_next(ahead).rig_time_s <= choose_runs(ahead).rig_time_s
