"""Parameters while a run is measured: the process that reads the record and fits, and how often it does."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from acquisition.record.writer import RecordWriter
from processing.fit import fit_exact
from processing.swing import HalfCycle, TurningPoints, turning_points
from rig.instrument import configuration_attachments, pendulum_on_ball
from rig.measure.posterior import LivePosterior
from rig.measure.posterior_worker import FIRST_HALF_CYCLES, Posterior
from rig.settings import load_configuration
from tests.processing.fit.decays import decay, paper_pair
from tests.rig.command_line import CONFIGS
from tests.waiting import LIMIT_S, until

PARAMETERS, PENDULUM = paper_pair("glass_k8")
POINTS = decay(PARAMETERS, PENDULUM, noise_arcsec=0.005, seed=4)


def half_cycles(points: TurningPoints) -> list[HalfCycle]:
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
        for half_cycle in half_cycles:
            self._records[-1].write_half_cycle(half_cycle)
            self.posterior.take([half_cycle], self._records[-1].flush)
            yield self.posterior.latest

    def grow(self, half_cycles: Sequence[HalfCycle]) -> Posterior:
        """What is known after all of them."""
        return list(self.by(half_cycles))[-1]

    def write(self, half_cycle: HalfCycle) -> None:
        """Write one and make it readable, of which the live fit is not told."""
        self._records[-1].write_half_cycle(half_cycle)
        self._records[-1].flush()

    def go_on(self) -> None:
        """Write what is no half-cycle, and make everything readable."""
        self._records[-1].write_event(0, "note", "it swings")
        self._records[-1].flush()

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
    measured = half_cycles(POINTS)[: FIRST_HALF_CYCLES + 6]
    known = list(growing.by(measured))
    assert [one.half_cycles for one in known[FIRST_HALF_CYCLES - 2 :]][:2] == [0, FIRST_HALF_CYCLES]
    # each with 4 % more than the one before
    assert sorted({one.half_cycles for one in known} - {0}) == [40, 42, 44, 46]
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
    rising = half_cycles(POINTS)[:FIRST_HALF_CYCLES][::-1]
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
    measured, posterior = half_cycles(POINTS), growing.posterior
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
    growing: Growing,
) -> None:
    """At least 50 times the processor time of the one before; that of 40 half-cycles is above 20 ms."""
    fitted_s, measured, sent, posterior = [], half_cycles(POINTS), 0, growing.posterior
    for count in (FIRST_HALF_CYCLES, FIRST_HALF_CYCLES + 2, FIRST_HALF_CYCLES + 4):
        growing.grow(measured[sent:count])
        sent = count
        while posterior.latest.half_cycles < count:
            # as a record with frames does
            growing.go_on()
            time.sleep(0.05)
        fitted_s.append(time.monotonic())
    assert fitted_s[2] - fitted_s[1] > 1.0
    before, pid = posterior.latest, posterior.worker_pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    # would wait for ever
    assert growing.grow(measured[sent:]) == before
    posterior.close()
    until(lambda: not alive(pid))


@pytest.mark.parametrize("synchronous", [False, True])
def test_the_process_ends_with_the_record_and_with_the_one_that_started_it(
    synchronous: bool, tmp_path: Path
) -> None:
    record = opened(tmp_path / "run-1.mcap")
    program = "from rig.measure.posterior_worker import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", program, str(record.path), *(["in step"] if synchronous else [])],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    if not synchronous:
        record.close()
    assert process.communicate(timeout=LIMIT_S) == (b"", b"")
    assert process.returncode == 0
    record.close()
