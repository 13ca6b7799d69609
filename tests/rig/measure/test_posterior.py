"""Parameters while a run is measured: the process that fits, its end, and how often it fits."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from processing.deflections import slow_deflections
from processing.fit import NO_EVIDENCE, Evidence, fit_exact
from processing.swing import HalfCycle, SwingHarmonics, TurningPoints, turning_points
from rig.measure import FIRST_HALF_CYCLES, FittedModel, LivePosterior, Posterior
from rig.measure.posterior import following
from tests.processing.fit.decays import decay, paper_pair

PARAMETERS, PENDULUM = paper_pair("glass_k8")
POINTS = decay(PARAMETERS, PENDULUM, noise_arcsec=0.005, seed=4)


def swings(points: TurningPoints) -> list[HalfCycle]:
    """Half-cycles with these turning points."""
    return [
        HalfCycle(
            int(index), round(time_s * 1e9), u_s, amplitude, u, 2.0, 1e-4, 0.0, 1 - 2 * (int(index) % 2), 0
        )
        for index, time_s, u_s, amplitude, u in zip(
            points.index, points.time_s, points.u_time_s, points.amplitude, points.u_amplitude, strict=True
        )
    ]


def fed(posterior: LivePosterior, half_cycles: Sequence[HalfCycle]) -> Iterator[Posterior]:
    """What is known after each half-cycle."""
    for swing in half_cycles:
        posterior.take([swing], NO_SAMPLES)
        yield posterior.latest


NO_SAMPLES = slow_deflections(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))


def nothing_beside(_: Sequence[HalfCycle], __: SwingHarmonics) -> Evidence:
    """What restrains a fit in vacuum beside the half-cycles."""
    return NO_EVIDENCE


@pytest.fixture
def in_step() -> Iterator[LivePosterior]:
    """Fits that the half-cycles wait for."""
    posterior = LivePosterior(FittedModel(PENDULUM, drag=False), nothing_beside, in_step=True)
    yield posterior
    posterior.close()


def test_what_is_known_is_the_fit_of_the_half_cycles_so_far(in_step: LivePosterior) -> None:
    measured = swings(POINTS)[: FIRST_HALF_CYCLES + 12]
    in_step.begin()
    known = list(fed(in_step, measured))
    counts = [FIRST_HALF_CYCLES]
    while following(counts[-1]) <= len(measured):
        counts.append(following(counts[-1]))
    assert [one.half_cycles for one in known[FIRST_HALF_CYCLES - 2 :: 1]][:2] == [0, FIRST_HALF_CYCLES]
    assert sorted({one.half_cycles for one in known} - {0}) == counts
    last = known[-1]
    cut = fit_exact(turning_points(measured[: last.half_cycles]), PENDULUM)
    assert tuple(last.estimates) == cut.contact_names
    for name, (value, u) in last.estimates.items():
        assert u == pytest.approx(cut.estimate(name).standard_uncertainty, rel=0.02)
        assert value == pytest.approx(cut.estimate(name).value, abs=0.02 * u)
    # a rejected start: what it told is forgotten
    in_step.begin()
    assert in_step.latest == Posterior()
    # half-cycles that are no decay change nothing, and flagged ones are not fitted
    rising = swings(POINTS)[:FIRST_HALF_CYCLES][::-1]
    assert list(fed(in_step, rising))[-1] == Posterior()
    assert in_step.take_remark() == ""
    in_step.begin()
    in_step.take([HalfCycle(0, 0, 1.0, 1.0, 1.0, 2.0, 1.0, 0.0, 1, flags=1)] * FIRST_HALF_CYCLES, NO_SAMPLES)
    assert in_step.latest == Posterior()


def test_frames_that_wait_for_a_fit_on_purpose_say_so(in_step: LivePosterior) -> None:
    """A run that `stop_when` may end said that its camera had stalled while the first fit compiled."""
    measured = swings(POINTS)[:FIRST_HALF_CYCLES]
    in_step.begin()
    in_step.take(measured[:-1], NO_SAMPLES, lambda: pytest.fail("nothing is waited for"))
    waited: list[int] = []
    in_step.take(measured[-1:], NO_SAMPLES, lambda: waited.append(1))
    assert waited
    assert in_step.latest.half_cycles == FIRST_HALF_CYCLES


def test_without_the_process_that_fits_the_half_cycles_go_on_and_it_is_said_once(
    in_step: LivePosterior,
) -> None:
    measured = swings(POINTS)
    in_step.begin()
    for _ in fed(in_step, measured[:FIRST_HALF_CYCLES]):
        pass
    before = in_step.latest
    assert before.half_cycles == FIRST_HALF_CYCLES
    assert in_step.worker_pid is not None
    os.kill(in_step.worker_pid, signal.SIGTERM)
    # at the next fit that is due; nothing waits for one that is gone
    assert list(fed(in_step, measured[FIRST_HALF_CYCLES:]))[-1] == before
    assert "has died" in in_step.take_remark()
    assert in_step.take_remark() == ""


def test_beside_a_measurement_a_fit_waits_for_its_share_of_a_core() -> None:
    """At least 50 times the processor time of the one before; that of 40 half-cycles is above 20 ms."""
    asked_s = []

    def asked(given: Sequence[HalfCycle], harmonics: SwingHarmonics) -> Evidence:
        asked_s.append(time.monotonic())
        return nothing_beside(given, harmonics)

    posterior = LivePosterior(FittedModel(PENDULUM, drag=False), asked)
    posterior.begin()
    measured, sent = swings(POINTS), 0
    for count in (FIRST_HALF_CYCLES, FIRST_HALF_CYCLES + 2, FIRST_HALF_CYCLES + 4):
        posterior.take(measured[sent:count], NO_SAMPLES)
        sent = count
        while posterior.latest.half_cycles < count:
            time.sleep(0.01)
    posterior.close()
    assert len(asked_s) == 3
    assert asked_s[2] - asked_s[1] > 1.0


def test_the_process_ends_with_the_one_that_started_it() -> None:
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", "from rig.measure.posterior_worker import main; main()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.communicate(timeout=50)[0] == b""
