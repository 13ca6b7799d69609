"""What the controller's thread decides, turn by turn, with the firmware on a stepped clock."""

from collections.abc import Callable
from concurrent.futures import Future

import pytest

from processing.errors import DeviceError
from rig.control.controller import Controller, InterlockOpen, PowerLimit
from rig.control.device_thread import DeviceThread, JobExpired
from rig.control.light_permit import LONGEST_PAUSE_S, LightPermit, LightRefused, Stage
from rig.control.protocol import AmbientReading, CommandRefused
from rig.control.safety_state import SafetyState, TripCause
from rig.control.serial_port import PortLost
from rig.control.service import ControlService, ControlState
from rig.control.settings import ControllerSettings
from tests.rig.control.stepped import Clock, SpoiledLine, SteppedBoard, turn

HEARTBEAT_S, WATCHDOG_S = 0.5, 2.0


@pytest.fixture
def board(clock: Clock) -> SteppedBoard:
    return SteppedBoard(clock)


@pytest.fixture
def state() -> SafetyState:
    return SafetyState()


@pytest.fixture
def permit(clock: Clock, state: SafetyState) -> LightPermit:
    return LightPermit(clock.monotonic, state)


def service_of(
    board: SteppedBoard, permit: LightPermit | None, period_s: float | None = 3.0, **stated: float
) -> ControlService:
    """A service of the board, whose air is read once a period, with these settings."""
    settings = ControllerSettings.model_validate({"kind": "serial", "port": "stepped", **stated})
    controller = Controller(settings, 0.001, board.open_line)
    return ControlService(controller, settings, environment_period_s=period_s, permit=permit)


@pytest.fixture
def service(board: SteppedBoard, permit: LightPermit) -> ControlService:
    return service_of(board, permit, heartbeat_s=HEARTBEAT_S, watchdog_s=WATCHDOG_S, timeout_s=0.1)


def lit(service: ControlService, board: SteppedBoard) -> None:
    """The service's controller open and the laser on."""
    turn(service)
    on = service.laser_on()
    turn(service)
    on.result(0)
    assert board.outputs()["laser"][0] == 1
    service.take_events()


def live(service: ControlService, board: SteppedBoard, duration_s: float) -> None:
    """Turns of both, as often as the service asks for them."""
    end_s = board.clock.monotonic() + duration_s
    while board.clock.monotonic() < end_s:
        board.turn(turn(service))


def test_an_output_that_does_not_follow_is_latched(
    service: ControlService, board: SteppedBoard, state: SafetyState
) -> None:
    lit(service, board)
    board.press(b"p")
    live(service, board, 1.0)
    assert state.trip is not None
    assert state.trip.cause is TripCause.OUTPUT


def test_what_a_program_that_was_killed_left_tripped_the_next_one_finds(
    service: ControlService, board: SteppedBoard, clock: Clock
) -> None:
    lit(service, board)
    board.turn(WATCHDOG_S + 0.1)
    assert board.outputs()["laser"][0] == 0
    state = SafetyState()
    turn(service_of(board, LightPermit(clock.monotonic, state), timeout_s=0.1))
    assert state.trip is not None
    assert state.trip.cause is TripCause.WATCHDOG


def test_an_off_outdates_a_light_that_still_waits(service: ControlService, board: SteppedBoard) -> None:
    turn(service)
    on = service.laser_on()
    service.laser_off()
    turn(service)
    with pytest.raises(DeviceError, match="it was switched off meanwhile"):
        on.result(0)
    assert board.count("laser", 1) == 0


def test_an_off_that_was_lost_on_the_line_is_given_until_it_is_dark(
    service: ControlService, board: SteppedBoard
) -> None:
    """Nothing is latched and nobody asks again: between two measurements a hand is in the beam's way."""
    lit(service, board)
    board.to_board = lambda data: b""
    off = service.laser_off()
    turn(service)
    with pytest.raises(DeviceError):
        off.result(0)
    board.to_board = bytes
    live(service, board, 1.0)
    assert service.snapshot.state is ControlState.OPEN
    assert board.outputs()["laser"][0] == 0


def test_light_whose_answer_was_lost_was_refused_and_is_dark(
    service: ControlService, board: SteppedBoard
) -> None:
    turn(service)
    on = service.laser_on()
    board.to_host = lambda data: b"" if b"OK*" in data else data
    turn(service)
    with pytest.raises(DeviceError):
        on.result(0)
    assert board.count("laser", 1) == 1
    board.to_host = bytes
    live(service, board, 1.0)
    assert board.outputs()["laser"][0] == 0


def test_an_off_is_never_too_late(board: SteppedBoard, permit: LightPermit) -> None:
    """A computer that stood still for less than the board's watchdog time must not forget it."""
    service = service_of(board, permit, watchdog_s=5.0, timeout_s=0.1)
    lit(service, board)
    service.laser_off()
    board.turn(4.0)
    turn(service)
    assert board.outputs()["laser"][0] == 0
    assert service.snapshot.state is ControlState.OPEN


def test_it_is_open_after_the_first_turn(service: ControlService, board: SteppedBoard, clock: Clock) -> None:
    assert service.snapshot.state is ControlState.OPENING
    assert turn(service) == HEARTBEAT_S
    snapshot = service.snapshot
    assert snapshot.state is ControlState.OPEN
    assert service.wait_open().serial == "TEST0001"
    assert snapshot.environment == AmbientReading(20.125, 45.5, 101325.0)
    assert snapshot.status_time_ns == clock.monotonic_ns()
    assert service.take_events() == ("TEST0001 is connected, firmware 1.4",)


def test_heartbeats_keep_it_lit_and_nothing_else_does(service: ControlService, board: SteppedBoard) -> None:
    lit(service, board)
    live(service, board, 10 * WATCHDOG_S)
    assert board.outputs()["laser"][0] == 1
    began_ms = board.ticks_ms()
    board.turn(2 * WATCHDOG_S)
    dark_ms = next(ms for ms, name, values in reversed(board.said) if name == "laser" and values[0] == 0)
    assert dark_ms - began_ms + HEARTBEAT_S * 1000 >= WATCHDOG_S * 1000
    assert dark_ms - began_ms <= WATCHDOG_S * 1000 + 10


def test_the_air_is_read_once_a_period(
    service: ControlService, board: SteppedBoard, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, asked_s = board.environment, list[float]()
    monkeypatch.setattr(board, "environment", lambda: [asked_s.append(clock.monotonic()), read()][1])
    for _ in range(21):
        board.turn(turn(service))
    periods_s = [at_s - asked_s[0] for at_s in asked_s]
    assert periods_s == pytest.approx([0.0, 3.0, 6.0, 9.0][: len(periods_s)], abs=0.1)
    assert len(periods_s) >= 3


def test_a_board_without_a_sensor_says_so_once(service: ControlService, board: SteppedBoard) -> None:
    board.sensor_works = False
    live(service, board, 20.0)
    said = [text for text in service.take_events() if "environment sensor" in text]
    assert said == ["error -240: Hardware error; environment sensor"]
    board.sensor_works = True
    live(service, board, 4.0)
    assert service.snapshot.environment.temperature_c == 20.125
    board.sensor_works = False
    live(service, board, 8.0)
    assert len(service.take_events()) == 1


def test_a_board_whose_sensor_is_not_wanted_is_not_asked(board: SteppedBoard) -> None:
    board.sensor_works = False
    service = service_of(board, None, None)
    live(service, board, 10.0)
    assert [text for text in service.take_events() if "error" in text] == []


def test_what_the_board_refuses_is_said_and_no_loss(service: ControlService) -> None:
    turn(service)
    service.take_events()
    release, power = service.submit(lambda c: c.release()), service.set_laser_power_w(1.0)
    turn(service)
    with pytest.raises(CommandRefused, match="holds nothing"):
        release.result(0)
    with pytest.raises(PowerLimit):
        power.result(0)
    assert service.snapshot.state is ControlState.OPEN
    turn(service)
    # what it refused stands in its list of errors, too
    assert [text.partition(":")[0] for text in service.take_events()] == ["stepped", "stepped", "error -221"]


def test_urgent_is_first(service: ControlService, board: SteppedBoard) -> None:
    turn(service)
    service.submit(lambda c: c.hold())
    service.laser_off()
    service.submit(lambda c: c.brake(True))
    before = len(board.said)
    turn(service)
    assert [name for _, name, _ in board.said[before:]] == ["laser", "magnet", "brake"]


@pytest.mark.parametrize("withdrawn", [True, False])
def test_without_a_permit_the_laser_goes_dark(
    service: ControlService, board: SteppedBoard, permit: LightPermit, withdrawn: bool
) -> None:
    lit(service, board)
    permit.begin()
    if withdrawn:
        permit.withdraw("stopped by the user")
    else:
        while not permit.refusal:
            permit.note_progress(Stage.PROCESSING)
            board.turn(turn(service))
    turn(service)
    assert board.outputs()["laser"][0] == 0
    reason = "stopped by the user" if withdrawn else "has stalled"
    assert any(text.startswith("laser off: ") and reason in text for text in service.take_events())
    on = service.laser_on()
    turn(service)
    with pytest.raises(DeviceError, match=f"the laser stays off: .*{reason}"):
        on.result(0)
    assert not any("laser off" in text for text in service.take_events())


def test_while_frames_have_stalled_the_board_gets_no_heartbeat(
    service: ControlService, board: SteppedBoard, permit: LightPermit
) -> None:
    """Its watchdog makes all safe even if the command to go dark was lost."""
    lit(service, board)
    service.submit(lambda c: c.hold())
    turn(service)
    permit.begin()
    live(service, board, max(LONGEST_PAUSE_S.values()) + 2 * WATCHDOG_S)
    assert board.outputs()["magnet"] == [0]
    assert any("WATCHDOG" in text for text in service.take_events())


def test_an_interlock_that_opens_is_noticed_by_the_permit(
    service: ControlService, board: SteppedBoard, permit: LightPermit, state: SafetyState
) -> None:
    lit(service, board)
    permit.begin()
    board.closed = False
    board.turn(0.02)
    board.closed = True
    turn(service)
    # closed again before it was looked at: the trip tells
    assert permit.refusal == "trip 1 (INTERLOCK): the interlock of the controller opened"
    assert "TRIP INTERLOCK" in service.take_events()
    state.acknowledge(1)
    board.closed = False
    on = service.laser_on()
    turn(service)
    assert permit.refusal == "trip 2 (INTERLOCK): the interlock of the controller opened"
    with pytest.raises((InterlockOpen, DeviceError)):
        on.result(0)


def test_an_opening_of_20_ms_latches_once_though_the_line_about_it_was_lost(
    service: ControlService, board: SteppedBoard, permit: LightPermit, state: SafetyState
) -> None:
    lit(service, board)
    board.to_host = lambda data: b"" if b"TRIP" in data else data
    board.closed = False
    board.turn(0.02)
    board.closed = True
    turn(service)
    assert permit.refusal == "trip 1 (INTERLOCK): the interlock of the controller opened"
    live(service, board, 3.0)
    # told once
    assert permit.latched is not None
    assert permit.latched.number == 1
    on = service.laser_on()
    turn(service)
    with pytest.raises(LightRefused, match="trip 1"):
        on.result(0)
    state.acknowledge(1)
    live(service, board, 2.0)
    assert state.trip is None
    assert board.outputs()["laser"][0] == 0


def test_a_reset_board_is_opened_again_and_stays_dark(
    service: ControlService, board: SteppedBoard, permit: LightPermit, state: SafetyState
) -> None:
    lit(service, board)
    board.press(b"r")
    board.turn()
    assert turn(service) == 0.5
    assert service.snapshot.state is ControlState.LOST
    assert service.snapshot.status is None
    assert service.snapshot.environment.temperature_c != service.snapshot.environment.temperature_c
    turn(service)
    assert service.snapshot.state is ControlState.OPEN
    assert service.snapshot.last_error == ""
    live(service, board, 3.0)
    assert board.outputs()["laser"][0] == 0
    events = service.take_events()
    assert sum("is connected" in text for text in events) == 1
    assert any("reset" in text for text in events)

    def asked() -> Future[None]:
        on = service.laser_on()
        turn(service)
        return on

    with pytest.raises(LightRefused, match=r"trip 1 \(POWER\): the controller was reset"):
        asked().result(0)
    state.acknowledge(1)
    with pytest.raises(LightRefused, match="until a person asks for light"):
        asked().result(0)
    assert board.outputs()["laser"][0] == 0
    permit.request_light()
    asked().result(0)
    assert board.outputs()["laser"][0] == 1


def test_an_unplugged_board_is_said_once(service: ControlService, board: SteppedBoard) -> None:
    turn(service)
    service.take_events()
    board.unplug()
    assert [turn(service), turn(service), turn(service)] == [0.5, 0.5, 0.5]
    said = service.take_events()
    assert [text for text in said if "check the cable" in text]
    assert len(said) == 2  # that it went, and that it cannot be opened
    on = service.laser_on()
    turn(service)
    with pytest.raises(PortLost, match="no such port"):
        on.result(0)
    board.connected = True
    turn(service)
    assert service.snapshot.state is ControlState.OPEN


def test_one_missing_answer_is_no_loss_but_silence_is(service: ControlService, board: SteppedBoard) -> None:
    lit(service, board)
    board.to_host = lambda data: b""
    turn(service)
    assert service.snapshot.state is ControlState.OPEN
    board.to_host = bytes
    board.turn(turn(service))
    assert board.outputs()["laser"][0] == 1
    board.to_host = lambda data: b""
    silent_from_s = board.clock.monotonic()
    while service.snapshot.state is ControlState.OPEN:
        board.turn(turn(service))
    assert WATCHDOG_S < board.clock.monotonic() - silent_from_s < 2 * WATCHDOG_S


@pytest.mark.parametrize("status", ["1,1,1,0.001,0,0,0,0,NONE,many", "1,maybe,1,0.001,0,0,0,0,NONE,0", "1,2"])
def test_a_status_that_makes_no_sense_does_not_end_the_service(
    service: ControlService, board: SteppedBoard, status: str
) -> None:
    """Its checksum is right: the board itself speaks nonsense for a while."""
    turn(service)
    usual: Callable[[str], str] = board.firmware._free["SYST:STAT?"]
    board.firmware._acting["SYST:HEAR?"] = lambda _: status
    turn(service)
    assert any(repr(status) in event for event in service.take_events())
    assert service.snapshot.state is ControlState.OPEN
    board.firmware._acting["SYST:HEAR?"] = usual
    turn(service)
    assert service.snapshot.status is not None


class Worker(DeviceThread):
    """Operates nothing."""

    def __init__(self, turn: Callable[[], float], finish: Callable[[], None]) -> None:
        self._turn_once, self._finish_once = turn, finish
        super().__init__("test")

    def _poll(self) -> float:
        return self._turn_once()

    def _finish(self) -> None:
        self._finish_once()


class TestWorker:
    """Which of its jobs a thread does, when."""

    @pytest.fixture
    def order(self) -> list[str]:
        return []

    @pytest.fixture
    def worker(self, clock: Clock, order: list[str]) -> Worker:
        return Worker(lambda: 1.0, lambda: order.append("finish"))

    def work_off(self, worker: Worker) -> None:
        while not worker._jobs.empty():
            worker._run_next_job(0.0)

    def test_urgent_jobs_go_first_and_late_ones_do_not_act(
        self, worker: Worker, order: list[str], clock: Clock
    ) -> None:
        late = worker._queue(lambda: order.append("late"), 0.05)
        worker._queue(lambda: order.append("just"), 0.101)
        first = worker._queue(lambda: order.append("first"), 10.0)
        urgent = worker._queue(lambda: order.append("urgent"), 10.0, urgent=True)
        cancelled = worker._queue(lambda: order.append("cancelled"), 10.0)
        assert cancelled.cancel()
        clock.sleep(0.1)
        self.work_off(worker)
        assert first.result(0) is urgent.result(0) is None
        with pytest.raises(JobExpired, match="not executed"):
            late.result(0)
        assert order == ["urgent", "just", "first"]

    def test_an_error_is_the_callers(self, worker: Worker) -> None:
        def fail() -> None:
            raise ZeroDivisionError("of the job")

        job = worker._queue(fail, 1.0)
        self.work_off(worker)
        with pytest.raises(ZeroDivisionError):
            job.result(0)
        assert worker.failure is None

    def test_what_waits_fails_when_it_is_closed(self, worker: Worker, order: list[str]) -> None:
        waiting = worker._queue(lambda: order.append("waiting"), 10.0)
        assert worker.close()
        worker._run()
        assert order == ["finish"]
        for job in (waiting, worker._queue(lambda: order.append("after"), 10.0)):
            with pytest.raises(DeviceError, match="test is closed"):
                job.result(0)

    def test_what_waits_fails_when_one_that_never_started_is_closed(self, worker: Worker) -> None:
        waiting = worker._queue(lambda: None, 10.0)
        assert worker.close()
        for job in (waiting, worker._queue(lambda: None, 10.0)):
            with pytest.raises(DeviceError, match="test is closed"):
                job.result(0)


def test_an_error_of_ours_ends_a_worker_with_its_reason() -> None:
    def fail() -> float:
        raise ZeroDivisionError("a fault of ours")

    finished: list[bool] = []
    worker = Worker(fail, lambda: finished.append(True))
    future = worker._queue(lambda: None, 10.0)
    worker._run()
    with pytest.raises(DeviceError, match="closed"):
        future.result(0)
    assert isinstance(worker.failure, ZeroDivisionError)
    assert finished == [True]


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
    board: SteppedBoard,
    permit: LightPermit,
    fault: Callable[[SpoiledLine], None],
    environment_period_s: float | None,
) -> None:
    """Its own watchdog hears the heartbeats: the program must give it up, and say so."""
    service = service_of(board, permit, environment_period_s)
    lit(service, board)
    line = SpoiledLine(board)
    for moment in range(4):
        live(service, board, 0.3 + 0.07 * moment)
    assert board.outputs()["laser"][0] == 1
    began_ms = board.ticks_ms()
    fault(line)
    live(service, board, 6.0)
    dark = [ms for ms, name, values in board.said if name == "laser" and ms > began_ms and not values[0]]
    print(f"dark after {(dark[0] - began_ms) / 1e3:.2f} s")
    assert dark[0] - began_ms <= 1500 + 5


@pytest.mark.parametrize("delay_s", [0.05, 0.15, 0.25])
def test_answers_that_come_a_little_late_are_answers(
    board: SteppedBoard, permit: LightPermit, delay_s: float
) -> None:
    service = service_of(board, permit, 1.0)
    lit(service, board)
    SpoiledLine(board).late(delay_s)
    live(service, board, 20.0)
    assert service.snapshot.state is ControlState.OPEN
    assert board.outputs()["laser"][0] == 1
