"""What the controller's thread decides, turn by turn, with the firmware on a stepped clock."""

import math
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import numpy as np
import pytest

from processing.errors import DeviceError
from rig.control.controller import Controller, PowerLimit
from rig.control.device_thread import DeviceThread, JobExpired
from rig.control.light_permit import LONGEST_PAUSE_S, LightPermit, Stage
from rig.control.protocol import AmbientReading, CommandRefused
from rig.control.safety_state import SafetyState, TripCause
from rig.control.service import ControlService, ControlState
from rig.control.settings import ControllerSettings
from tests.rig.control.stepped import Clock, SpoiledLine, SteppedBoard, turn

HEARTBEAT_S, WATCHDOG_S = 0.5, 2.0


class Bench:
    """A controller's service, turned by hand, with its board, permit and the state of its rig."""

    def __init__(self, clock: Clock) -> None:
        self.clock, self.board, self.state = clock, SteppedBoard(clock), SafetyState()
        self.permit = LightPermit(clock.monotonic, self.state)
        self.service = self.another(heartbeat_s=HEARTBEAT_S, watchdog_s=WATCHDOG_S, timeout_s=0.1)

    def another(self, period_s: float | None = 3.0, **stated: float) -> ControlService:
        """A service of the board, whose air is read once a period, with these settings."""
        settings = ControllerSettings.model_validate({"kind": "serial", "port": "stepped", **stated})
        controller = Controller(settings, 0.001, self.board.open_line)
        self.service = ControlService(controller, settings, environment_period_s=period_s, permit=self.permit)
        return self.service

    def turn(self) -> float:
        return turn(self.service)

    def done(self, job: Future[Any]) -> Any:
        """What becomes of a job in the next turn."""
        self.turn()
        return job.result(0)

    def refused(self, said: str | None = None) -> None:
        """A light that is asked for now is refused, with these words."""
        with pytest.raises(DeviceError, match=said):
            self.done(self.service.laser_on())

    def light(self) -> None:
        """The controller open and the laser on."""
        self.turn()
        self.done(self.service.laser_on())
        assert self.lit
        self.service.take_events()

    @property
    def lit(self) -> bool:
        return self.board.outputs()["laser"][0] == 1

    @property
    def is_open(self) -> bool:
        return self.service.snapshot.state is ControlState.OPEN

    def live(self, duration_s: float) -> None:
        """Turns of both, as often as the service asks for them."""
        end_s = self.clock.monotonic() + duration_s
        while self.clock.monotonic() < end_s:
            self.board.turn(self.turn())

    def open_interlock(self) -> None:
        """For 20 ms."""
        self.board.closed = False
        self.board.turn(0.02)
        self.board.closed = True


@pytest.fixture
def bench(clock: Clock) -> Bench:
    return Bench(clock)


def test_an_output_that_does_not_follow_is_latched(bench: Bench) -> None:
    bench.light()
    bench.board.press(b"p")
    bench.live(1.0)
    assert bench.state.trip is not None
    assert bench.state.trip.cause is TripCause.OUTPUT


def test_what_a_program_that_was_killed_left_tripped_the_next_one_finds(bench: Bench) -> None:
    bench.light()
    bench.board.turn(WATCHDOG_S + 0.1)
    assert not bench.lit
    bench.another(timeout_s=0.1)
    bench.turn()
    assert bench.state.trip is not None
    assert bench.state.trip.cause is TripCause.WATCHDOG


def test_an_off_outdates_a_light_that_still_waits(bench: Bench) -> None:
    bench.turn()
    on = bench.service.laser_on()
    bench.service.laser_off()
    with pytest.raises(DeviceError, match="it was switched off meanwhile"):
        bench.done(on)
    assert bench.board.count("laser", 1) == 0


def test_an_off_that_was_lost_on_the_line_is_given_until_it_is_dark(bench: Bench) -> None:
    """Nothing is latched and nobody asks again: between two measurements a hand is in the beam's way."""
    bench.light()
    bench.board.to_board = lambda data: b""
    with pytest.raises(DeviceError):
        bench.done(bench.service.laser_off())
    bench.board.to_board = bytes
    bench.live(1.0)
    assert bench.is_open
    assert not bench.lit


def test_light_whose_answer_was_lost_was_refused_and_is_dark(bench: Bench) -> None:
    bench.turn()
    bench.board.to_host = lambda data: b"" if b"OK*" in data else data
    bench.refused()
    assert bench.board.count("laser", 1) == 1
    bench.board.to_host = bytes
    bench.live(1.0)
    assert not bench.lit


def test_an_off_is_never_too_late(bench: Bench) -> None:
    """A computer that stood still for less than the board's watchdog time must not forget it."""
    bench.another(watchdog_s=5.0, timeout_s=0.1)
    bench.light()
    bench.service.laser_off()
    bench.board.turn(4.0)
    bench.turn()
    assert not bench.lit
    assert bench.is_open


def test_it_is_open_after_the_first_turn(bench: Bench) -> None:
    assert bench.service.snapshot.state is ControlState.OPENING
    assert bench.turn() == HEARTBEAT_S
    snapshot = bench.service.snapshot
    assert snapshot.state is ControlState.OPEN
    assert bench.service.wait_open().serial == "TEST0001"
    assert snapshot.environment == AmbientReading(20.125, 45.5, 101325.0)
    assert snapshot.status_time_ns == bench.clock.monotonic_ns()
    assert bench.service.take_events() == ("TEST0001 is connected, firmware 1.4",)


def test_heartbeats_keep_it_lit_and_nothing_else_does(bench: Bench) -> None:
    bench.light()
    bench.live(10 * WATCHDOG_S)
    assert bench.lit
    began_ms = bench.board.ticks_ms()
    bench.board.turn(2 * WATCHDOG_S)
    dark_ms = next(ms for ms, name, values in reversed(bench.board.said) if name == "laser" and not values[0])
    assert dark_ms - began_ms + HEARTBEAT_S * 1000 >= WATCHDOG_S * 1000
    assert dark_ms - began_ms <= WATCHDOG_S * 1000 + 10


def test_the_air_is_read_once_a_period(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    read, asked_s = bench.board.environment, list[float]()
    monkeypatch.setattr(
        bench.board, "environment", lambda: [asked_s.append(bench.clock.monotonic()), read()][1]
    )
    bench.live(10.4)
    assert np.diff(asked_s) == pytest.approx([3.0, 3.0, 3.0], abs=0.1)


def test_a_board_without_a_sensor_says_so_once_and_is_not_asked_where_none_is_wanted(bench: Bench) -> None:
    bench.board.sensor_works = False
    bench.live(20.0)
    said = [text for text in bench.service.take_events() if "environment sensor" in text]
    assert said == ["error -240: Hardware error; environment sensor"]
    bench.board.sensor_works = True
    bench.live(4.0)
    assert bench.service.snapshot.environment.temperature_c == 20.125
    bench.board.sensor_works = False
    bench.live(8.0)
    assert len(bench.service.take_events()) == 1
    bench.another(None)
    bench.live(10.0)
    assert [text for text in bench.service.take_events() if "error" in text] == []


def test_what_the_board_refuses_is_said_and_no_loss(bench: Bench) -> None:
    bench.turn()
    bench.service.take_events()
    release, power = bench.service.submit(lambda c: c.release()), bench.service.set_laser_power_w(1.0)
    with pytest.raises(CommandRefused, match="holds nothing"):
        bench.done(release)
    with pytest.raises(PowerLimit):
        power.result(0)
    assert bench.is_open
    bench.turn()
    # what it refused stands in its list of errors, too
    said = [text.partition(":")[0] for text in bench.service.take_events()]
    assert said == ["stepped", "stepped", "error -221"]


def test_urgent_is_first(bench: Bench) -> None:
    bench.turn()
    bench.service.submit(lambda c: c.hold())
    bench.service.laser_off()
    bench.service.submit(lambda c: c.brake(True))
    before = len(bench.board.said)
    bench.turn()
    assert [name for _, name, _ in bench.board.said[before:]] == ["laser", "magnet", "brake"]


@pytest.mark.parametrize("reason", ["stopped by the user", "has stalled"])
def test_without_a_permit_the_laser_goes_dark(bench: Bench, reason: str) -> None:
    bench.light()
    bench.permit.begin()
    if reason == "stopped by the user":
        bench.permit.withdraw(reason)
    while not bench.permit.refusal:
        bench.permit.note_progress(Stage.PROCESSING)
        bench.board.turn(bench.turn())
    bench.turn()
    assert not bench.lit
    assert any(text.startswith("laser off: ") and reason in text for text in bench.service.take_events())
    bench.refused(f"the laser stays off: .*{reason}")
    assert not any("laser off" in text for text in bench.service.take_events())


def test_while_frames_have_stalled_the_board_gets_no_heartbeat(bench: Bench) -> None:
    """Its watchdog makes all safe even if the command to go dark was lost."""
    bench.light()
    bench.done(bench.service.submit(lambda c: c.hold()))
    bench.permit.begin()
    bench.live(max(LONGEST_PAUSE_S.values()) + 2 * WATCHDOG_S)
    assert bench.board.outputs()["magnet"] == [0]
    assert any("WATCHDOG" in text for text in bench.service.take_events())


@pytest.mark.parametrize("lost", [False, True])
def test_an_opening_of_20_ms_latches_once_though_the_line_about_it_was_lost(bench: Bench, lost: bool) -> None:
    """Closed again before it was looked at: the trip tells, or the number of the board's latch."""
    bench.light()
    bench.permit.begin()
    if lost:
        bench.board.to_host = lambda data: b"" if b"TRIP" in data else data
    bench.open_interlock()
    bench.turn()
    assert bench.permit.refusal == "trip 1 (INTERLOCK): the interlock of the controller opened"
    assert ("TRIP INTERLOCK" in bench.service.take_events()) is not lost
    bench.live(3.0)
    # told once
    assert bench.permit.latched is not None
    assert bench.permit.latched.number == 1
    bench.refused("trip 1")
    bench.state.acknowledge(1)
    bench.live(2.0)
    assert bench.state.trip is None
    assert not bench.lit
    bench.open_interlock()
    bench.turn()
    assert bench.permit.refusal == "trip 2 (INTERLOCK): the interlock of the controller opened"
    bench.state.acknowledge(2)
    bench.board.closed = False
    bench.refused()
    assert bench.permit.refusal == "trip 3 (INTERLOCK): the interlock of the controller opened"


def test_a_reset_board_is_opened_again_and_stays_dark(bench: Bench) -> None:
    bench.light()
    bench.board.press(b"r")
    bench.board.turn()
    assert bench.turn() == 0.5
    snapshot = bench.service.snapshot
    assert (snapshot.state, snapshot.status) == (ControlState.LOST, None)
    assert math.isnan(snapshot.environment.temperature_c)
    bench.turn()
    assert bench.is_open
    assert bench.service.snapshot.last_error == ""
    bench.live(3.0)
    assert not bench.lit
    events = bench.service.take_events()
    assert sum("is connected" in text for text in events) == 1
    assert any("reset" in text for text in events)
    bench.refused(r"trip 1 \(POWER\): the controller was reset")
    bench.state.acknowledge(1)
    bench.refused("until a person asks for light")
    assert not bench.lit
    bench.permit.request_light()
    bench.done(bench.service.laser_on())
    assert bench.lit


def test_an_unplugged_board_is_said_once(bench: Bench) -> None:
    bench.turn()
    bench.service.take_events()
    bench.board.unplug()
    assert [bench.turn(), bench.turn(), bench.turn()] == [0.5, 0.5, 0.5]
    said = bench.service.take_events()
    assert [text for text in said if "check the cable" in text]
    assert len(said) == 2  # that it went, and that it cannot be opened
    bench.refused("no such port")
    bench.board.connected = True
    bench.turn()
    assert bench.is_open


def test_one_missing_answer_is_no_loss_but_silence_is(bench: Bench) -> None:
    bench.light()
    bench.board.to_host = lambda data: b""
    bench.turn()
    assert bench.is_open
    bench.board.to_host = bytes
    bench.board.turn(bench.turn())
    assert bench.lit
    bench.board.to_host = lambda data: b""
    silent_from_s = bench.clock.monotonic()
    while bench.is_open:
        bench.board.turn(bench.turn())
    assert WATCHDOG_S < bench.clock.monotonic() - silent_from_s < 2 * WATCHDOG_S


@pytest.mark.parametrize("status", ["1,1,1,0.001,0,0,0,0,NONE,many", "1,maybe,1,0.001,0,0,0,0,NONE,0", "1,2"])
def test_a_status_that_makes_no_sense_does_not_end_the_service(bench: Bench, status: str) -> None:
    """Its checksum is right: the board itself speaks nonsense for a while."""
    bench.turn()
    firmware = bench.board.firmware
    firmware._acting["SYST:HEAR?"] = lambda _: status
    bench.turn()
    assert any(repr(status) in event for event in bench.service.take_events())
    assert bench.is_open
    firmware._acting["SYST:HEAR?"] = firmware._free["SYST:STAT?"]
    bench.turn()
    assert bench.service.snapshot.status is not None


@pytest.mark.parametrize("environment_period_s", [None, 1.0])
@pytest.mark.parametrize(
    "fault",
    [
        SpoiledLine.mute,
        SpoiledLine.half_lines,
        SpoiledLine.old_replies,
        SpoiledLine.nan,
        SpoiledLine.wrong_values,
        SpoiledLine.very_late,
    ],
)
def test_a_board_that_says_nothing_of_use_is_dark_within_the_watchdogs_time(
    bench: Bench, fault: Callable[[SpoiledLine], None], environment_period_s: float | None
) -> None:
    """Its own watchdog hears the heartbeats: the program must give it up, and say so."""
    bench.another(environment_period_s)
    bench.light()
    line = SpoiledLine(bench.board)
    bench.live(1.6)
    # a state has come just now: its silence begins as late as it can
    bench.turn()
    assert bench.lit
    began_ms = bench.board.ticks_ms()
    fault(line)
    bench.live(6.0)
    dark = [
        ms for ms, name, values in bench.board.said if name == "laser" and ms > began_ms and not values[0]
    ]
    assert dark[0] - began_ms <= 1500 + 5


@pytest.mark.parametrize("delay_s", [0.05, 0.15, 0.25])
def test_answers_that_come_a_little_late_are_answers(bench: Bench, delay_s: float) -> None:
    bench.another(1.0)
    bench.light()
    SpoiledLine(bench.board).late(delay_s)
    bench.live(20.0)
    assert bench.is_open
    assert bench.lit


class Worker(DeviceThread):
    """Operates nothing."""

    def __init__(self, turn: Callable[[], float], finish: Callable[[], None]) -> None:
        self._turn_once, self._finish_once = turn, finish
        super().__init__("test")

    def _poll(self) -> float:
        return self._turn_once()

    def _finish(self) -> None:
        self._finish_once()


@pytest.fixture
def order() -> list[str]:
    return []


@pytest.fixture
def worker(clock: Clock, order: list[str]) -> Worker:
    return Worker(lambda: 1.0, lambda: order.append("finish"))


def work_off(worker: Worker) -> None:
    while not worker._jobs.empty():
        worker._run_next_job(0.0)


def test_urgent_jobs_go_first_and_late_ones_do_not_act(
    worker: Worker, order: list[str], clock: Clock
) -> None:
    late = worker._queue(lambda: order.append("late"), 0.05)
    worker._queue(lambda: order.append("just"), 0.101)
    first = worker._queue(lambda: order.append("first"), 10.0)
    urgent = worker._queue(lambda: order.append("urgent"), 10.0, urgent=True)
    cancelled = worker._queue(lambda: order.append("cancelled"), 10.0)
    assert cancelled.cancel()
    clock.sleep(0.1)
    work_off(worker)
    assert first.result(0) is urgent.result(0) is None
    with pytest.raises(JobExpired, match="not executed"):
        late.result(0)
    assert order == ["urgent", "just", "first"]


def test_an_error_is_the_callers(worker: Worker) -> None:
    job = worker._queue(lambda: 1 // 0, 1.0)
    work_off(worker)
    with pytest.raises(ZeroDivisionError):
        job.result(0)
    assert worker.failure is None


@pytest.mark.parametrize("started", [True, False])
def test_what_waits_fails_when_it_is_closed(worker: Worker, order: list[str], started: bool) -> None:
    waiting = worker._queue(lambda: order.append("waiting"), 10.0)
    assert worker.close()
    if started:
        worker._run()
    assert order == ["finish"] * started
    for job in (waiting, worker._queue(lambda: order.append("after"), 10.0)):
        with pytest.raises(DeviceError, match="test is closed"):
            job.result(0)


def test_an_error_of_ours_ends_a_worker_with_its_reason(order: list[str]) -> None:
    worker = Worker(lambda: 1 / 0, lambda: order.append("finish"))
    future = worker._queue(lambda: None, 10.0)
    worker._run()
    with pytest.raises(DeviceError, match="closed"):
        future.result(0)
    assert isinstance(worker.failure, ZeroDivisionError)
    assert order == ["finish"]
