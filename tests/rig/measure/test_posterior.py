"""The live fit: the process that reads the record and fits, how often it does, and what it finds."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from calibration import Axes
from processing.contact.laws import PAPER
from processing.deflections import Deflections, DeflectionUnit
from processing.fit import DecayFit, LinearisedFit, fit_exact, fitted_twice, with_discrepancy
from processing.spot import Spot
from processing.swing import (
    HalfCycle,
    HarmonicsMeasurement,
    TurningPointDetector,
    TurningPoints,
    turning_points,
)
from processing.units import ARCSEC_RAD
from rig.analysis import evidence_of, refined_half_cycles
from rig.analysis.ambient import FREE_DRAG
from rig.analysis.passing_deflections import PassingDeflections
from rig.analysis.turning_plane import follow_plane
from rig.instrument import configuration_attachments, pendulum_on_ball
from rig.measure.posterior import (
    FIRST_HALF_CYCLES,
    LivePosterior,
    Posterior,
    RunSoFar,
    fitted_points,
    next_fit_half_cycles,
)
from rig.settings import FitSettings, load_configuration
from tests.processing.fit.decays import decay, paper_pair
from tests.processing.fit.driven import driven_path
from tests.rig.command_line import CONFIGS
from tests.waiting import until

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


def opened(record: Path) -> RecordWriter:
    """A record of a rig in vacuum, without a frame."""
    config = load_configuration(
        CONFIGS / "demo.toml",
        ["fit.drag='vacuum'", f"pendulum.mass_kg={PENDULUM.mass_kg}", "pendulum.ball_radius_m=6.05e-3"],
    )
    assert pendulum_on_ball(config) == PENDULUM
    return RecordWriter(record, 10**18, attachments=configuration_attachments(config, Path("none")))


class Growing:
    """A record that grows by half-cycles, and the live fit that is told of them."""

    def __init__(self, posterior: LivePosterior, folder: Path) -> None:
        self.posterior, self._folder, self._records = posterior, folder, list[RecordWriter]()

    def begin(self) -> None:
        """Begin with another record."""
        record = self._folder / f"run-{len(self._records) + 1}.mcap"
        self._records.append(opened(record))
        self.posterior.begin(record)

    def by(self, half_cycles: Sequence[HalfCycle]) -> Iterator[Posterior]:
        """What is known after each half-cycle."""
        for swing in half_cycles:
            self._records[-1].write_swing(swing)
            self.posterior.take([swing], self._records[-1].flush)
            yield self.posterior.latest

    def grow(self, half_cycles: Sequence[HalfCycle]) -> Posterior:
        """What is known after all of them."""
        return list(self.by(half_cycles))[-1]

    def write(self, half_cycle: HalfCycle) -> None:
        """Write one and make it readable, of which the live fit is not told."""
        self._records[-1].write_swing(half_cycle)
        self._records[-1].flush()

    def go_on(self) -> None:
        """Write what is no half-cycle, make all readable, and tell the live fit that there was none."""
        self._records[-1].write_event(0, "note", "it swings")
        self._records[-1].flush()
        self.posterior.take([])

    def close(self) -> None:
        """End the process, and close the records."""
        self.posterior.close()
        for record in self._records:
            record.close()


@pytest.fixture
def growing(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Growing]:
    """With fits that the half-cycles wait for; with the parameter False, with fits beside them."""
    found = Growing(LivePosterior(synchronous=getattr(request, "param", True)), tmp_path)
    found.begin()
    yield found
    found.close()


def test_what_is_known_is_the_fit_of_the_half_cycles_so_far(
    growing: Growing, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = swings(POINTS)[: FIRST_HALF_CYCLES + 6]
    known = list(growing.by(measured))
    counts = [FIRST_HALF_CYCLES]
    while next_fit_half_cycles(counts[-1]) <= len(measured):
        counts.append(next_fit_half_cycles(counts[-1]))
    assert [one.half_cycles for one in known[FIRST_HALF_CYCLES - 2 :: 1]][:2] == [0, FIRST_HALF_CYCLES]
    assert sorted({one.half_cycles for one in known} - {0}) == counts
    last = known[-1]
    cut = fit_exact(turning_points(measured[: last.half_cycles]), PENDULUM)
    assert tuple(last.estimates) == cut.contact_names
    for name, (value, u) in last.estimates.items():
        assert u == pytest.approx(cut.estimate(name).standard_uncertainty, rel=0.02)
        assert value == pytest.approx(cut.estimate(name).value, abs=0.02 * u)
    # a rejected start: what it told is forgotten, and the process waited for however long it takes to die:
    # else it stays as a zombie
    pid = growing.posterior.worker_pid
    assert pid is not None
    with monkeypatch.context() as hurried:
        hurried.setattr("rig.measure.posterior._CALL_INTERVAL_S", 0.0)
        growing.begin()
    assert growing.posterior.latest == Posterior()
    assert growing.posterior.worker_pid is None
    until(lambda: not alive(pid))
    # half-cycles that are no decay change nothing, and flagged ones are not fitted
    rising = swings(POINTS)[:FIRST_HALF_CYCLES][::-1]
    assert growing.grow(rising) == Posterior()
    assert growing.posterior.worker_pid is not None
    assert growing.posterior.take_remark() == ""
    growing.begin()
    flagged = [HalfCycle(0, 0, 1.0, 1.0, 1.0, 2.0, 1.0, 0.0, 1, flags=1)] * FIRST_HALF_CYCLES
    assert growing.grow(flagged) == Posterior()
    assert growing.posterior.worker_pid is None


def test_frames_that_wait_for_a_fit_on_purpose_say_so_and_go_on_without_the_process(
    growing: Growing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that `stop_when` may end said that its camera had stalled while the first fit compiled."""
    # no process starts within that
    monkeypatch.setattr("rig.measure.posterior._CALL_INTERVAL_S", 0.02)
    measured, posterior = swings(POINTS), growing.posterior
    growing.grow(measured[: FIRST_HALF_CYCLES - 1])
    said: list[str] = []

    def flush() -> None:
        said.append("flush")
        growing.write(measured[FIRST_HALF_CYCLES - 1])

    posterior.take(measured[FIRST_HALF_CYCLES - 1 : FIRST_HALF_CYCLES], flush, lambda: said.append("waiting"))
    assert said[:2] == ["waiting", "flush"]
    assert "waiting" in said[2:]
    before = posterior.latest
    assert before.half_cycles == FIRST_HALF_CYCLES
    # nothing waits for a process that is gone, and that is said once
    assert posterior.worker_pid is not None
    os.kill(posterior.worker_pid, signal.SIGTERM)
    assert growing.grow(measured[FIRST_HALF_CYCLES:]) == before
    assert "has died" in posterior.take_remark()
    assert posterior.take_remark() == ""


def alive(pid: int) -> bool:
    """Whether there is a process of this number, be it a zombie."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.skipif(os.name != "posix", reason="processes are stopped by signals")
@pytest.mark.parametrize("growing", [False], indirect=True)
def test_beside_a_measurement_a_fit_waits_for_its_share_of_a_core_and_nothing_for_a_fit(
    growing: Growing, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured, sent, posterior = swings(POINTS), 0, growing.posterior
    for count in (FIRST_HALF_CYCLES, FIRST_HALF_CYCLES + 2):
        growing.grow(measured[sent:count])
        sent = count
        while posterior.latest.half_cycles < count:
            # as a record with frames does
            growing.go_on()
            time.sleep(0.05)
        # the second fit takes more than the share of many hours
        monkeypatch.setattr("rig.measure.posterior._MAX_CORE_FRACTION", 1e-9)
    growing.grow(measured[sent : sent + 4])
    sent += 4
    for _ in range(20):
        growing.go_on()
        time.sleep(0.05)
    assert posterior.latest.half_cycles == FIRST_HALF_CYCLES + 2
    before, pid = posterior.latest, posterior.worker_pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    posterior._due_s = 0.0
    # would wait for ever
    assert growing.grow(measured[sent:]) == before
    posterior.close()
    until(lambda: not alive(pid))


@pytest.mark.parametrize("asked", [b"", b"1\n"])
def test_the_process_ends_with_the_record_and_with_the_one_that_started_it(
    asked: bytes, tmp_path: Path
) -> None:
    record = opened(tmp_path / "run-1.mcap")
    if asked:
        record.close()
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", "from rig.measure.posterior import main; main()", str(record.path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    if asked:
        assert process.stdin is not None
        process.stdin.write(asked)
        process.stdin.flush()
        assert process.wait(50) == 0
    assert process.communicate(timeout=50) == (b"", b"")
    assert process.returncode == 0
    record.close()


OF_GLASS, GLASS = paper_pair("glass_k8", 1.7e-3)
HALF_CYCLES = 120
SPOT = Spot(9.0, 9.0, 0.01, 0.01, 3.0, 3.0, 0.0, 200.0, 8.0, 1.0, 0)
Measured = tuple[list[HalfCycle], Deflections]


def measured(turn_deg: float, q: float) -> Measured:
    """Half-cycles in a plane that turns by so much in five minutes, on ground that moves by `q`.

    With what they were found in: 25 frames a second, 0.02 arcsec.
    """
    _, _, path = driven_path(OF_GLASS, GLASS, q=q, seed=3, frames_per_s=25.0)
    path = path[: 25 * 260]
    angle = np.radians(turn_deg) * np.linspace(0.0, 1.0, len(path))
    u = np.full(len(path), 0.02 * ARCSEC_RAD)
    seen = np.stack((path * np.sin(angle), path * np.cos(angle)))
    seen += u * np.random.default_rng(11).standard_normal(seen.shape)
    times_ns = np.arange(len(path), dtype=np.int64) * 40_000_000
    samples = Deflections(times_ns, seen[0], seen[1], u, u, DeflectionUnit.RAD)
    swings = TurningPointDetector().update(samples.times_ns, samples.y, samples.u_y)
    end_ns = swings[HALF_CYCLES].turn_time_ns
    return swings[:HALF_CYCLES], samples[: int(np.searchsorted(times_ns, end_ns))]


@cache
def shaken() -> Measured:
    return measured(0.0, 1e-9)


@cache
def turned() -> Measured:
    return measured(6.0, 0.0)


def how(swings: list[HalfCycle], samples: Deflections) -> DecayFit:
    watch = HarmonicsMeasurement(swings)
    watch.update(samples)
    return DecayFit(GLASS, evidence=evidence_of(FREE_DRAG, watch.harmonics()))


@pytest.mark.parametrize(("seen", "at_least"), [(shaken, 0.1), (turned, 3.0)])
def test_a_live_fit_is_that_of_the_final_analysis_of_the_same_half_cycles(
    seen: Callable[[], Measured], at_least: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Measured a second time, in the plane of swing; the half-cycles as detected would not do."""
    swings, samples = seen()
    count = sum(not swing.flags for swing in swings)
    pendulum = [f"pendulum.{name}={getattr(GLASS, name)}" for name in ("mass_kg", "ball_radius_m")]
    pendulum.append(f"pendulum.contact_radius_m={GLASS.contact_radius_m}")
    config = load_configuration(CONFIGS / "demo.toml", ["fit.drag='open'", *pendulum])
    assert pendulum_on_ball(config) == GLASS
    attachments = configuration_attachments(config, Path("none"))
    with RecordWriter(tmp_path / "run.mcap", 10**18, attachments=attachments) as writer:
        for first in range(0, len(samples), 250):
            part = samples[first : first + 250]
            times_ns = part.times_ns.tolist()
            numbers = range(first, first + len(part))
            writer.write_spots(numbers, times_ns, times_ns, [SPOT] * len(part), part)
        for swing in swings:
            writer.write_swing(swing)
    with RecordReader(tmp_path / "run.mcap") as reader:
        run = RunSoFar(reader)
        assert run.wait_for(count)
        assert not run.wait_for(count + 1)
        live = run.fitted()
        # a later fit begins with the one before
        again = run.fitted()
        followed = follow_plane(swings, PassingDeflections([samples], DeflectionUnit.RAD), Axes())
        # of a plane that cannot be followed nothing is said
        withheld = replace(followed, problem="withheld")
        monkeypatch.setattr("rig.measure.posterior.follow_plane", lambda *_: withheld)
        assert run.fitted() == Posterior(count)
    assert followed.is_turned is (seen is turned)
    refined = refined_half_cycles(
        followed.swings, followed.deflections, DeflectionUnit.RAD, GLASS, FitSettings()
    )
    assert refined.exact is not None
    points = how(swings, samples).points(refined.swings)
    final = with_discrepancy(LinearisedFit.of(points, GLASS, refined.exact))
    detected, moved = how(swings, samples).of(swings), 0.0
    assert (live.half_cycles, len(live.points)) == (count, len(points.index))
    for name in PAPER.names(drag=True)[:-2]:
        value, u = final.estimate(name)
        for estimate in (live.estimates[name], again.estimates[name]):
            assert estimate.standard_uncertainty == pytest.approx(u, rel=0.02), name
            assert estimate.value == pytest.approx(value, abs=0.02 * u), name
        moved = max(moved, abs(detected.estimate(name).value - value) / u)
    assert moved > at_least


def test_a_fit_is_drawn_at_its_half_cycles_and_leaves_their_scatter() -> None:
    swings, samples = shaken()
    fit_of = how(swings, samples)
    (stand, *_), fit = fitted_twice(swings, [samples], fit_of)
    points = fit_of.points(stand)
    drawn = fitted_points(stand, points, fit, GLASS)
    assert [one.turn_time_ns for one in drawn] == [swing.turn_time_ns for swing in stand if not swing.flags]
    fitted, left = np.array([(one.amplitude_rad, one.amplitude_residual) for one in drawn]).T
    left_of_period = np.array([one.period_residual for one in drawn[1:-1]])
    again = fitted + left * points.u_amplitude
    np.testing.assert_allclose(again, points.amplitude, rtol=1e-12)
    assert all(later < earlier for earlier, later in pairwise(fitted)), "a free decay"
    assert np.isnan([drawn[0].period_s, drawn[-1].period_s]).all()
    # the ground moves it more than the reading of a turning point is uncertain, by less than tens of u
    for residuals in (left, left_of_period):
        assert 0.5 < np.std(residuals) < 30.0
        assert abs(np.mean(residuals)) < np.std(residuals)
    # a long run is thinned
    many = [replace(swing, index=k) for k, swing in enumerate(stand * 6)]
    assert 0 < len(fitted_points(many, fit_of.points(many), fit, GLASS)) <= 300
