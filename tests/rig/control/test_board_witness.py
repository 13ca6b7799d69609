"""The accelerometer on the controller's board: its driver, its samples, and what goes before them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from acquisition.record.topics import WITNESS
from processing.arrays import Floats
from processing.errors import ConfigurationError, DeviceError
from rig.analysis.recorded_witness import recorded_witness
from rig.control import controller as controller_module
from rig.control.board_witness import BoardSamples, BoardWitness, samples_of, sensor_of
from rig.control.controller import Controller
from rig.control.firmware import core
from rig.control.firmware.adxl355 import RATE_HZ, Adxl355
from rig.control.lasers import LaserSettings
from rig.control.ports import check_controller
from rig.control.service import ControlService
from rig.control.settings import WitnessSettings
from rig.control.witness import WitnessSample
from rig.devices.ground_witness import board_witness
from rig.instrument import recorded_configuration
from rig.measure import measure_session
from rig.settings import load_configuration
from tests.rig.conftest import APPARATUS, CONFIGS, SMALL
from tests.rig.control.conftest import micropython_boards, settings_for
from tests.rig.control.micropython.fake_adxl355 import FakeAdxl355
from tests.rig.control.stepped import SteppedBoard, stepped_clock, turn
from tests.rig.control.wires import FirmwareBoard

Board = FirmwareBoard | SteppedBoard
SETTINGS = WitnessSettings(kind="controller", columns=("x", "y", "z"))


@pytest.fixture(params=["stepped", pytest.param("micropython", marks=pytest.mark.realtime)])
def board(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Board]:
    """A board of either kind."""
    if request.param == "micropython":
        with micropython_boards(request.getfixturevalue("micropython"), tmp_path) as make:
            yield make()
    else:
        stepped = SteppedBoard(stepped_clock(monkeypatch))
        monkeypatch.setattr(controller_module, "SerialPort", lambda *_, **__: stepped.open_line())
        yield stepped


@contextmanager
def serviced(board: Board) -> Iterator[tuple[ControlService, BoardWitness]]:
    """A service with the board's witness; whoever has it lets it turn."""
    settings = settings_for(board.port, heartbeat_s=0.2, watchdog_s=5.0)
    witness = BoardWitness(SETTINGS)
    service = ControlService(Controller(settings, 0.001), settings, None, witness=witness)
    try:
        yield service, witness
    finally:
        service._finish()


def live(service: ControlService, board: Board, until: Callable[[], bool], timeout_s: float = 30.0) -> None:
    """Turns of the service, as often as it asks for them, until something holds."""

    def turned() -> bool:
        board.sleep(turn(service)) if isinstance(board, FirmwareBoard) else board.turn(turn(service))
        return until()

    board.wait_for(turned, timeout_s)


def taken(service: ControlService, witness: BoardWitness, board: Board, count: int) -> list[WitnessSample]:
    """So many samples."""
    found: list[WitnessSample] = []

    def enough() -> bool:
        found.extend(witness.take_samples())
        return len(found) >= count

    live(service, board, enough)
    return found


class Ticks:
    """A clock that a test moves, in ms."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_the_driver_sets_the_chip_up_and_empties_its_memory() -> None:
    ticks = Ticks()
    chip = FakeAdxl355(ticks)  # type: ignore[no-untyped-call]
    sensor = Adxl355(chip)
    assert sensor.read() == (False, [], 0)
    ticks.now = 64.0 * 6
    lost, samples, left = sensor.read()
    assert (lost, len(samples), left) == (False, 4, 2)
    assert samples[1] == bytes.fromhex("000011fffff03e8000")
    assert [len(one) for one in sensor.read()[1]] == [9, 9]
    # two seconds are what its memory holds
    ticks.now += 64.0 * 40
    assert sensor.read()[0] is True
    assert sensor.read()[0] is False


def test_another_chip_none_and_a_memory_out_of_step_are_errors() -> None:
    ticks = Ticks()
    chip = FakeAdxl355(ticks)  # type: ignore[no-untyped-call]
    sensor = Adxl355(chip)
    ticks.now = 64.0
    chip.slips = True
    assert sensor.read() == (False, [], 0)
    ticks.now = 128.0
    with pytest.raises(OSError, match="out of step"):
        sensor.read()
    chip.power()
    ticks.now += 1000.0
    assert sensor.read() == (False, [], 0)
    chip.present = False
    with pytest.raises(OSError, match="5"):
        Adxl355(chip)
    chip.present = True
    chip.readfrom_mem = lambda *_: b"\xad\x1d\xee"
    with pytest.raises(OSError, match="no ADXL355"):
        Adxl355(chip)


def test_replies_are_read_and_others_refused() -> None:
    assert sensor_of("ADXL355,15.625,256000").step_ms == 64.0
    assert samples_of("1,3,9,70,1000,1010,000011fffff03e8000") == BoardSamples(
        True, 3, 9, 70, 1000, 1010, ((1, -1, 256000),)
    )
    assert samples_of("0,0,0,7,0,1010,").values == ()
    for reply in ("", "1,0,0,7,0,1010", "1,0,0,7,0,1010,00", "1,0,0,x,0,1010,", "1,0,0,7,0,1010,zz"):
        with pytest.raises(DeviceError, match="not accelerometer samples"):
            samples_of(reply)
    for reply in ("ADXL355", "ADXL355,0,1", "ADXL355,nan,1", "ADXL355,a,b"):
        with pytest.raises(DeviceError, match="not a sensor"):
            sensor_of(reply)


@pytest.mark.slow
def test_each_sample_comes_once_and_evenly_on_the_boards_clock(board: Board) -> None:
    with serviced(board) as (service, witness):
        found = taken(service, witness, board, 60)
        assert service.take_events()[0].endswith(f"firmware {core.VERSION}")
        assert not witness.silent
        assert witness.alive
        assert (witness.take_events(), service.snapshot.junk_lines) == ((), 0)
    number = np.array([one.value[0] for one in found])
    assert np.array_equal(number, number[0] + np.arange(len(number)))
    assert [one.value[1:] for one in found] == [(-one.value[0], 256000.0) for one in found]
    own_s = np.array([one.own_time_s for one in found])
    assert np.all(np.diff(own_s) > 0)
    if isinstance(board, SteppedBoard):
        # its clock is 0.8 % fast, which the board's ticks show; a turn of the loop is 5 ms
        assert np.polyfit(number, own_s, 1)[0] == pytest.approx(1 / RATE_HZ / 1.008, rel=1e-3)
        at_ms = np.array(board.bus.taken_ms)[number.astype(int)]
        host_ms = np.array([one.host_time_ns for one in found]) * 1e-6
        assert np.all(np.abs(host_ms - at_ms) <= 11.0)


def test_ticks_that_begin_anew_and_a_board_that_was_reset_do_not_set_its_time_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = stepped_clock(monkeypatch)
    clock.now_ns = ((1 << 30) - 3000) * 1_000_000
    board = SteppedBoard(clock)
    monkeypatch.setattr(board, "ticks_ms", lambda: clock.now_ns // 1_000_000 % (1 << 30))
    half = 1 << 29
    monkeypatch.setattr(board, "ticks_diff", lambda a, b: (a - b + half) % (1 << 30) - half)
    monkeypatch.setattr(board, "ticks_add", lambda a, d: (a + d) % (1 << 30))
    monkeypatch.setattr(controller_module, "SerialPort", lambda *_, **__: board.open_line())
    with serviced(board) as (service, witness):
        found = taken(service, witness, board, 80)
        board.press(b"r")
        found += taken(service, witness, board, 80)
    own_s = np.array([one.own_time_s for one in found])
    assert np.all(np.diff(own_s) > 0)
    host_s = np.array([one.host_time_ns for one in found]) * 1e-9
    assert own_s == pytest.approx(host_s, abs=0.02)


@pytest.mark.slow
def test_a_sensor_that_is_missing_is_named_and_found_when_it_is_plugged_in(board: Board) -> None:
    board.press(b"a")
    with serviced(board) as (service, witness):
        live(service, board, lambda: witness.alive is False)
        (said,) = witness.take_events()
        assert said == "ADXL355 on the controller's board does not answer: check its supply and wires"
        assert witness.silent
        board.press(b"A")
        taken(service, witness, board, 10)
        assert witness.take_events() == ("ADXL355 on the controller's board answers",)
        # pulled while it works, then a bus that hangs
        for off, on in ((b"a", b"A"), (b"i", b"I")):
            board.press(off)
            live(service, board, lambda: not witness.alive)
            board.press(on)
            live(service, board, lambda: bool(witness.alive))
            witness.take_samples()
            number = [one.value[0] for one in taken(service, witness, board, 10)]
            assert np.array_equal(np.diff(number), np.ones(len(number) - 1))
        assert not any("error" in said for said in service.take_events())


def test_doctor_names_it(board: Board) -> None:
    laser = LaserSettings()
    settings = settings_for(board.port)

    def verdict() -> tuple[bool, str]:
        checks = check_controller(Controller(settings, 0.001), settings, laser, SETTINGS)
        (found,) = [check for check in checks if check.name == "witness"]
        return found.ok, found.reason

    assert verdict() == (True, "ADXL355 on the controller's board, 15.625 per s")
    board.press(b"a")
    if isinstance(board, FirmwareBoard):
        board.wait_for(lambda: not verdict()[0], 30.0)
    assert verdict() == (False, "ADXL355 on the controller's board does not answer")


@pytest.mark.slow
def test_a_full_memory_drops_the_oldest_samples_and_counts_them(board: Board) -> None:
    controller = Controller(settings_for(board.port, watchdog_s=5.0), 0.001)
    controller.open()
    controller.start_witness()
    board.wait_for(lambda: bool(controller.heartbeat() and controller.witness_samples().values), 30.0)
    before = controller.witness_samples()
    until_ms = before.now_ms + 8000
    # it is fed and answers all along, and nobody asks for samples
    board.wait_for(lambda: controller.heartbeat().uptime_ms > until_ms, 60.0)
    block = controller.witness_samples()
    assert block.dropped > 0
    # a block ends where a busy computer's loop came too late for the sensor's memory
    assert len(block.values) + block.waiting == core.WITNESS_KEPT
    assert block.first > block.dropped
    assert controller.line_counts()[0] == 0
    controller.close()


def test_the_witness_has_only_turns_without_a_command_and_ends_with_the_session(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    board = SteppedBoard(stepped_clock(monkeypatch))
    monkeypatch.setattr(controller_module, "SerialPort", lambda *_, **__: board.open_line())
    looks: list[int] = []
    read = board.read_witness
    monkeypatch.setattr(board, "read_witness", lambda: looks.append(board.ticks_ms()) or read())
    board.turn(1.0)
    controller = Controller(settings_for(board.port, watchdog_s=1.0), 0.001)
    controller.open()
    board.turn(0.5)
    assert looks == []
    controller.start_witness()
    board.turn(0.5)
    assert len(looks) > 50
    looks.clear()
    board.hear(b"\n" * 10)
    board.firmware.step()
    assert looks == []
    # nobody feeds the watchdog: the laser goes dark, and nothing is looked at any more
    controller.laser_on()
    board.turn(1.2)
    assert board.outputs()["laser"][0] == 0
    looks.clear()
    board.turn(1.0)
    assert looks == []
    assert board.sent().count(b"TRIP") == 1


def test_a_host_that_hangs_is_sent_no_samples_and_the_laser_goes_dark(board: Board) -> None:
    controller = Controller(settings_for(board.port, watchdog_s=1.0), 0.001)
    controller.open()
    controller.start_witness()
    board.press(b"i")
    controller.laser_on()
    board.wait_for(lambda: board.outputs()["laser"][0] == 0, 30.0)
    with pytest.raises(DeviceError, match="no session"):
        controller.heartbeat()
    # what came meanwhile is the trip alone
    assert [event.name for event in controller.take_events()] == ["TRIP"]
    assert controller.line_counts() == (0, 0, 0)
    controller.close()


def test_a_reply_that_fails_leaves_the_line_to_the_heartbeats(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = stepped_clock(monkeypatch)
    board = SteppedBoard(clock)
    monkeypatch.setattr(controller_module, "SerialPort", lambda *_, **__: board.open_line())
    with serviced(board) as (service, witness):
        taken(service, witness, board, 5)
        service.take_events()
        asked: list[float] = []

        def deaf(data: bytes) -> bytes:
            if b"WITN:DATA?" in data:
                asked.append(clock.monotonic())
                return b""
            return data

        board.to_board = deaf
        before = board.firmware.heard_ms
        end_s = clock.monotonic() + 6.0
        while clock.monotonic() < end_s:
            board.turn(turn(service))
        assert board.firmware.token
        assert board.firmware.heard_ms > before + 4000
        # three tries at a time, and then a pause
        assert 6 <= len(asked) <= 12
        board.to_board = bytes
        number = [one.value[0] for one in taken(service, witness, board, 60)]
        # 4 s are kept on the board, less is lost
        assert np.all(np.diff(number) > 0)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ("", "rejected WITN:STAR"),
        ("ADXL355", "'ADXL355', which is not a sensor"),
    ],
    ids=["refused", "nonsense"],
)
def test_a_board_that_refuses_its_accelerometer_gives_light_without_it(
    answer: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = stepped_clock(monkeypatch)
    board = SteppedBoard(clock)
    monkeypatch.setattr(controller_module, "SerialPort", lambda *_, **__: board.open_line())
    if answer:
        monkeypatch.setitem(board.firmware._acting, "WITN:STAR", lambda _: answer)
    else:
        for header in ("WITN:STAR", "WITNESS:START"):
            monkeypatch.delitem(board.firmware._acting, header)
    with serviced(board) as (service, witness):
        end_s = clock.monotonic() + 5.0
        while clock.monotonic() < end_s:
            board.turn(turn(service))
        assert service.snapshot.state == "open"
        assert service.snapshot.status is not None
        assert reason in witness.refusal
        assert [said for said in service.take_events() if reason in said] == [witness.refusal]
        lit = service.laser_on()
        board.turn(turn(service))
        lit.result(0)
        assert board.outputs()["laser"][0] == 1
    settings = settings_for(board.port)
    checks = check_controller(Controller(settings, 0.001), settings, LaserSettings(), SETTINGS)
    found = {check.name: check for check in checks}
    assert found["controller"].ok
    assert not found["witness"].ok
    assert reason in found["witness"].reason


def test_names_of_columns_are_its_axes() -> None:
    with pytest.raises(ValueError, match="has its own clock"):
        WitnessSettings(kind="controller", columns=("time_s", "x"))


def test_without_a_controller_there_is_none() -> None:
    with pytest.raises(ConfigurationError, match=r"the controller's board: set controller\.kind"):
        board_witness(load_configuration(CONFIGS / "demo.toml", ("witness.kind='controller'",)))


def recorded(folder: Path, *changes: str) -> tuple[Floats, Floats]:
    """Times of samples in s and their components (n, 2), of a run of some seconds in real time."""
    wanted = (
        *(f"{key}={value}" for key, value in SMALL.items()),
        *APPARATUS,
        "session.max_duration_s=8",
        "simulation.real_time=true",
        "preflight.when='never'",
        "witness.kind='controller'",
        "witness.columns=['x', 'y']",
        *changes,
    )
    source = CONFIGS / "demo.toml"
    measure_session(load_configuration(source, wanted), source, folder)
    with RecordReader(folder / "run-1.mcap") as reader:
        found = recorded_witness(reader, recorded_configuration(reader))
        spots = reader.spots()["time_ns"]
        table = reader.table(WITNESS.topic)
    assert found is not None
    assert found.names == ("x", "y")
    assert np.all(table["time_ns"] >= spots[0])
    assert len(found.value) > 6 * RATE_HZ
    return (found.times_ns + found.first_ns - spots[0]) * 1e-9, found.value


@pytest.mark.slow
@pytest.mark.realtime
def test_a_run_records_what_the_board_measures(micropython: Path, tmp_path: Path) -> None:
    with micropython_boards(micropython, tmp_path) as make:
        board = make()
        time_s, value = recorded(
            tmp_path / "run", "controller.kind='serial'", f"controller.port='{board.port}'"
        )
    number = value[:, 0]
    assert np.array_equal(value[:, 1], -number)
    # every sample once; its clock is 0.8 % fast, and node shares this machine
    assert np.array_equal(np.diff(number), np.ones(len(number) - 1))
    line = np.polyfit(number, time_s, 1)
    assert line[0] == pytest.approx(1 / RATE_HZ / 1.008, rel=0.02)


@pytest.mark.slow
@pytest.mark.realtime
def test_the_simulated_controller_offers_it(tmp_path: Path) -> None:
    time_s, value = recorded(
        tmp_path / "run",
        "controller.kind='simulated'",
        "simulation.ground.model='white'",
        "simulation.ground.white_m_per_s2_per_sqrt_hz=2e-3",
    )
    # counts of the part per m/s2, white up to half its rate
    spread = np.std(value, axis=0) / (256000 / 9.80665)
    assert spread == pytest.approx(2e-3 * np.sqrt(RATE_HZ / 2), rel=0.5)
    # the board's loop is a thread that others hold up
    assert np.polyfit(np.arange(len(time_s)), time_s, 1)[0] == pytest.approx(1 / RATE_HZ, rel=0.02)
