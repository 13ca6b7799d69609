"""What is said of a run follows from its numbers, not from the sentences stored beside them."""

from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest

from processing.contact import MATERIALS
from processing.damping import fit_damping
from processing.estimate import Determinacy, Estimate
from processing.fit import (
    Budget,
    Drag,
    DragFinding,
    FitMethod,
    Ground,
    InputQuantity,
    RigQuantities,
    fit_asymptotic,
    fit_exact,
)
from processing.fit.uncertainty import BudgetSource
from rig.analysis import RunResults
from rig.analysis.contact_verdicts import fit_results, with_contact
from rig.analysis.decay_values import amplitude_damping
from rig.analysis.result_rows import SURFACE_ENERGY, ResultRow
from rig.analysis.results import Fit
from rig.analysis.run_remarks import (
    RemarkLevel,
    ground_sentence,
    main_result,
    remark_rows,
    remarks,
)
from rig.analysis.run_values import StoredTurningPoints
from rig.analysis.series import AnalysedRun
from rig.terminal import Verdict
from tests.processing.fit.decays import decay, paper_pair
from tests.processing.fit.driven import driven_decay

_SEEN = Drag(
    drag_s=Estimate(2e-3, 1e-4),
    of_data_s=Estimate(2.1e-3, 1.1e-4),
    known_s=Estimate(1.5e-3, 1e-3),
    p_value=1e-9,
    relative_shift_b=-0.012,
    relative_shift_c=0.034,
    finding=DragFinding.SEEN,
)


@pytest.mark.parametrize(
    ("finding", "begins"),
    [(DragFinding.NEGATIVE, "A negative drag fits best"), (DragFinding.UNSEEN, "No linear drag is seen: ")],
)
def test_a_verdict_on_the_drag_is_said(finding: DragFinding, begins: str) -> None:
    results = RunResults(record="run-1.mcap", drag=replace(_SEEN, finding=finding))
    assert remarks(results)[0].startswith(begins)


_DRIVEN = Ground(
    density_rad_per_s2_rthz=Estimate(8e-9, 4e-10),
    upper_95=9e-9,
    seen=True,
    widening={"b": 1.4, "c": 1.6, "n": 7.0},
)


def test_the_ground_is_a_value_where_it_is_seen_a_bound_elsewhere_and_says_what_it_costs() -> None:
    seen, unseen = ground_sentence(_DRIVEN), ground_sentence(replace(_DRIVEN, seen=False))
    assert seen.startswith("Ground at the pendulum's frequency: (8.00 ± 0.40)")
    assert unseen == "Ground at the pendulum's frequency: below 9.0 × 10⁻⁹ rad/s²/√Hz (95 %)."
    # b, which is hardly less certain by it, is not named
    assert "by factors of 7.0 (n), 1.6 (c). Finer balancing" in seen
    assert "factors" not in ground_sentence(replace(_DRIVEN, widening={"b": 1.4}))
    left_out = ground_sentence(replace(_DRIVEN, left_out_half_cycles=12))
    assert "; the last 12 half-cycles are its motion and were not fitted." in left_out
    assert not any(word in seen for word in ("(95 %)", "half-cycles"))


def test_of_what_is_not_determined_no_change_in_per_cent_is_told() -> None:
    """A live run of 35 half-cycles in a basement said that b would differ by -100 %."""
    open_b = ResultRow(quantity="b", verdict=Determinacy.INTERVAL, lower=0.0038, upper=1.0)
    open_drag = ResultRow(quantity="drag_s", verdict=Determinacy.UNDETERMINED)
    run = RunResults(record="run-1.mcap", drag=_SEEN, table=(open_b,))
    assert remarks(run)[0] == "The decay shows a linear drag: (2.00 ± 0.10) × 10⁻³ s; it changes c by +3.4 %."
    without = replace(run, table=(open_b, open_drag), fits={"exact": Fit()})
    assert remarks(without)[0] == "The decay shows a linear drag; it changes c by +3.4 %."


@pytest.mark.parametrize(
    ("of_data", "known", "words"),
    [
        (Estimate(1e-7, 1e-6), Estimate(1.8e-3, 1.3e-3), "a drag below 2.0 × 10⁻⁶ s (95 %)"),
        (Estimate(1e-7, 1e-6), None, "is in no uncertainty (fit.drag = vacuum)"),
        (
            Estimate(1e-3, 5e-3),
            Estimate(1.8e-3, 1.3e-3),
            "the drag expected of the air, (1.8 ± 1.3) × 10⁻³ s, is used; its uncertainty is part of all",
        ),
        (Estimate(nan, nan), None, "state what you know of the air (fit.drag)"),
    ],
)
def test_where_the_data_do_not_tell_it_is_said_whose_drag_it_is(
    of_data: Estimate, known: Estimate | None, words: str
) -> None:
    upper_s = of_data.value + 1.9 * of_data.standard_uncertainty
    drag = Drag(of_data_s=of_data, known_s=known, upper_95_s=upper_s)
    (line,) = remarks(RunResults(record="run-1.mcap", drag=drag))
    assert "distinguish a drag" in line
    assert words in line


def test_a_drag_that_is_seen_is_for_every_reader_and_vacuum_too() -> None:
    vacuum = Fit(parameters={"b": Estimate(3.7e-3, 1e-5)})
    with_drag = replace(vacuum, parameters={**vacuum.parameters, "drag_s": Estimate(2e-3, 1e-4)})
    uneven = ResultRow(quantity="drag_s", verdict=Determinacy.INTERVAL, lower=1.58e-3, upper=2.09e-3)
    run = RunResults(record="run-1.mcap", drag=_SEEN, fits={"exact": with_drag}, table=(uneven,))
    (seen,) = remark_rows(run, RemarkLevel.RESULT)
    assert seen.text.startswith("The decay shows a linear drag: (1.58 … 2.09) × 10⁻³ (95 %) s; it changes")
    in_vacuum, seen = remark_rows(replace(run, fits={"exact": vacuum}, table=()), RemarkLevel.RESULT)
    assert in_vacuum.text.startswith("Fitted without a drag, as in vacuum")
    assert seen.text.endswith("(2.00 ± 0.10) × 10⁻³ s; it changes b by −1.2 % and c by +3.4 %.")


def test_the_table_of_remarks_says_who_has_to_read_what() -> None:
    """Of quantities, what is hardly determined, and nothing of what is."""
    known = ResultRow(quantity="b", value=1e-3, lower=9e-4, upper=1.1e-3)
    bound = ResultRow(quantity="c", verdict=Determinacy.UPPER_BOUND, lower=0.0, upper=2e-9)
    run = RunResults(
        record="run-1.mcap",
        fits={"exact": Fit(ground=_DRIVEN, information_gain={"waveform": {"b": 12.0, "p": 1.1}})},
        table=(known, bound),
        conditions=(Verdict("light", True), Verdict("end", False, "cut", "again", "none", "its own")),
        warnings=("asymptotic fit: far", "late"),
        notes=("a note",),
    )
    waveform = "Without the waveform of the swing the uncertainties would be larger, by factors of 12 (b)."
    advice = "b is limited by: half-cycles. To improve it: measure longer, or make more runs."
    assert [(row.code, row.level, row.line) for row in remark_rows(run)] == [
        ("ground", RemarkLevel.RESULT, ground_sentence(_DRIVEN)),
        ("waveform", RemarkLevel.DETAIL, waveform),
        ("advice", RemarkLevel.ADVICE, advice),
        ("not determined", RemarkLevel.DETAIL, "Not determined: c, < 2.0 × 10⁻⁹ (95 %)."),
        ("note", RemarkLevel.DETAIL, "a note"),
        ("end", RemarkLevel.CONDITION, "END: none (limit its own); cut; again"),
        ("warning", RemarkLevel.OTHER_FIT, "asymptotic fit: far"),
        ("warning", RemarkLevel.WARNING, "late"),
    ]
    assert remarks(RunResults(record="run-1.mcap", fits={"exact": Fit()})) == []


def test_what_is_said_first_is_named_and_nobody_is_sent_to_quieter_ground_without_need() -> None:
    """With the whole uncertainty; ground that is not seen to move asks for more swings."""
    budget = Budget(
        value=0.0834,
        standard_uncertainty=0.0013,
        sources=tuple(
            BudgetSource(name, "B", 1.0, 1.0, share**0.5, share)
            for name, share in (("swings", 0.4), ("ground", 0.6))
        ),
    )
    row = ResultRow(quantity=SURFACE_ENERGY, value=0.0834, u=0.0007, u_total=0.0013)
    for seen in (True, False):
        fits = {FitMethod.EXACT: Fit(ground=replace(_DRIVEN, seen=seen))}
        run = RunResults(record="run-1.mcap", table=(row,), budget={SURFACE_ENERGY: budget}, fits=fits)
        assert main_result(run).text == "surface energy σ (Table 2's form) = 83.4 ± 1.3 mJ/m²"
        assert ("quieter" in " ".join(main_result(run).next_steps)) is seen


def test_a_driven_run_says_what_drives_it_and_what_that_costs() -> None:
    parameters, pendulum = paper_pair("glass_k8")
    points = driven_decay(parameters, pendulum, q=1e-8, noise_arcsec=0.005, seed=2, last_arcsec=10)
    found = fit_results(fit_exact(points, pendulum, averaged=False)).ground
    assert found is not None
    assert found.seen
    assert min(found.widening.values()) > 3


@pytest.mark.parametrize(
    ("exponent", "part", "reason"), [(0.94, "quadratic", "exponent below 1"), (1.3, "constant", "above 1")]
)
def test_a_power_law_of_rolling_is_not_called_a_change(exponent: float, part: str, reason: str) -> None:
    """A loss by A^p: its three parts have different signs, and nothing changes during the decay."""
    time_s = np.linspace(0.0, 600.0, 300)
    # dA/dt = -0.005 A^p, from 124 on, with p != 1
    at = 124 ** (1 - exponent) - 0.005 * (1 - exponent) * time_s
    lines = amplitude_damping(
        fit_damping(time_s, at ** (1 / (1 - exponent)), np.full(300, 1e-3)), frequency_hz=0.25
    ).lines("arcsec")
    (told,) = (line for line in lines if line.startswith("a negative"))
    assert told.startswith(f"a negative {part} part is no force")
    assert reason in told


@pytest.mark.usefixtures("verdicts")
def test_the_work_of_adhesion_is_as_uncertain_as_c() -> None:
    """It is 4 m g R c times the amplitude; what may have aged or drifted was missing from its uncertainty."""
    parameters, pendulum = paper_pair("glass_k8")
    points = decay(parameters, pendulum, noise_arcsec=0.005, seed=3)
    stored = StoredTurningPoints(
        index=points.index, time_s=points.time_s, u_time_s=points.u_time_s,
        amplitude=points.amplitude, u_amplitude=points.u_amplitude,
    )  # fmt: skip
    rig = RigQuantities(
        InputQuantity(0.406), InputQuantity(6.05e-3), MATERIALS["steel"], MATERIALS["glass_k8"],
        InputQuantity(1.0), InputQuantity(1.0), ageing=InputQuantity(0.0, 0.01),
    )  # fmt: skip
    fitted = {
        FitMethod.EXACT: fit_exact(points, pendulum, averaged=False),
        FitMethod.ASYMPTOTIC: fit_asymptotic(points, pendulum),
    }
    run = with_contact(
        AnalysedRun(path=Path(), record="run-1.mcap", turning_points=stored, fitted=fitted, rig=rig), pendulum
    )
    c = run["c"]
    assert c.u_total > 1.5 * c.u
    for work in run.work_per_cycle:
        value, u = work.adhesive_4at_j
        assert u / value == pytest.approx(c.u_total / c.value, rel=1e-3)


def test_a_quality_factor_is_as_uncertain_as_its_frequency() -> None:
    """The period of a rolling pendulum changes with the amplitude: more than its time constant is unknown."""
    time_s = np.linspace(0.0, 600.0, 300)
    noise = 1e-4 * np.random.default_rng(1).standard_normal(300)
    found = fit_damping(time_s, 124 * np.exp(-time_s / 300) + noise, np.full(300, 1e-4))
    for point in amplitude_damping(found, 0.25, u_frequency=0.002).curve:
        q, u = point.quality_factor
        by_time_constant = point.time_constant_s.standard_uncertainty / point.time_constant_s.value
        assert by_time_constant < 1e-4
        assert u / q == pytest.approx(np.hypot(0.002, by_time_constant), rel=1e-9)
