"""The host's controller with the firmware, on a real MicroPython and, without waiting, on CPython."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from processing.errors import DeviceError
from rig.control import controller as controller_module
from rig.control.controller import Controller, InterlockOpen, PowerLimit
from rig.control.firmware.core import VERSION
from rig.control.protocol import AmbientReading, CommandRefused, ControllerReset, checksum, encode
from rig.control.serial_port import PortLost, ReplyTimeout
from tests.rig.control.conftest import micropython_boards, settings_for
from tests.rig.control.stepped import SteppedBoard, stepped_clock
from tests.rig.control.wires import FirmwareBoard

MAX_W = 0.0008

Board = FirmwareBoard | SteppedBoard

OF_THE_HOST = pytest.mark.parametrize("make_board", ["stepped"], indirect=True)
"""What does not depend on the board's interpreter."""


@pytest.fixture(params=["stepped", "micropython"])
def make_board(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., Board]]:
    """Starts boards of either kind and ends them with the test."""
    if request.param == "micropython":
        with micropython_boards(request.getfixturevalue("micropython"), tmp_path) as make:
            yield make
    else:
        board = SteppedBoard(stepped_clock(monkeypatch))
        monkeypatch.setattr(controller_module, "SerialPort", lambda *_, **__: board.open_line())
        yield lambda through_wire=False: board


@pytest.fixture
def wired(make_board: Callable[..., Board]) -> Board:
    """A board on a wire that can spoil and lose."""
    return make_board(through_wire=True)


def opened(board: Board, **changes: object) -> Controller:
    controller = Controller(settings_for(board.port, **changes), MAX_W)
    controller.open()
    return controller


def test_it_says_who_it_is_and_every_command_reaches_its_output(board: Board) -> None:
    controller = Controller(settings_for(board.port, watchdog_s=5.0), MAX_W)
    identity = controller.open()
    assert (identity.serial, identity.firmware, identity.laser_max_w) == ("TEST0001", VERSION, 0.001)
    controller.set_laser_power_w(0.0005)
    assert board.outputs()["laser"] == [0, 0]
    controller.laser_on()
    assert board.outputs()["laser"] == [1, 0.0005]
    controller.set_laser_power_w(0.00025)
    assert board.outputs()["laser"] == [1, 0.00025]
    controller.hold()
    assert board.outputs()["magnet"] == [1]
    controller.clamp(True)
    assert board.outputs()["clamp"] == [1]
    controller.brake(True)
    assert board.outputs()["brake"] == [1]
    status = controller.heartbeat()
    on = (status.laser_on, status.magnet_on, status.clamp_closed, status.brake_on, status.interlock_closed)
    assert on == (True,) * 5
    assert (status.laser_power_w, status.trip) == (0.00025, "NONE")
    assert controller.environment() == AmbientReading(20.125, 45.5, 101325.0)
    controller.release()
    assert board.outputs()["magnet"] == [0]
    with pytest.raises(CommandRefused, match="holds nothing"):
        controller.release()
    controller.laser_off()
    assert board.outputs()["laser"][0] == 0
    controller.close()
    # The end of a session leaves the clamp where it was: moving it could strike the ball.
    assert board.outputs()["clamp"] == [1]
    # a sensor that is gone gives NaN, and not an old value
    controller = opened(board, watchdog_s=5.0)
    while controller.next_error()[0]:
        pass
    board.press(b"x")
    board.wait_for(lambda: math.isnan(controller.environment().pressure_pa), 20.0)
    assert controller.next_error()[1] == "Hardware error; environment sensor"


def test_pulse_ends_by_itself_and_brake_has_a_longest_time(board: Board) -> None:
    controller = opened(board, watchdog_s=5.0)
    controller.starter_pulse(0.080)
    controller.brake(True)
    board.wait_for(lambda: board.outputs()["brake"] == [0], 20.0)
    began, ended = [row[0] for row in board.events() if row[1] == "starter"][-2:]
    # Nobody told it to end; how much later it did is a matter of this machine. Both times are whole ms.
    assert ended - began >= 80 - 1
    with pytest.raises(DeviceError, match="starter_max_s"):
        controller.starter_pulse(60.0)
    controller.starter_pulse(5.0)
    with pytest.raises(CommandRefused, match="pulse is running"):
        controller.starter_pulse(0.5)


def test_pulses_are_set_in_the_dark_and_forgotten_with_the_session(board: Board) -> None:
    controller = opened(board, watchdog_s=5.0)
    assert board.outputs()["pulse"] == [0, 0]
    controller.set_laser_pulse(4800.0, 20.5)
    assert board.outputs()["pulse"] == [4800, 20.5]
    for delay_us, width_us in ((0.0, 0.9), (-1.0, 20.0), (0.0, 1.1e6), (math.nan, 20.0), (0.0, math.nan)):
        with pytest.raises(CommandRefused, match="out of range"):
            controller.set_laser_pulse(delay_us, width_us)
    controller.set_laser_power_w(0.0005)
    controller.laser_on()
    with pytest.raises(CommandRefused, match="the laser is on"):
        controller.set_laser_pulse(0.0, 20.0)
    assert board.outputs()["pulse"] == [4800, 20.5]
    controller.close()
    opened(board).close()
    assert board.outputs()["pulse"] == [0, 0]


def test_interlock_is_read_before_enabling_and_trips_while_lit(board: Board) -> None:
    controller = opened(board, watchdog_s=5.0)
    board.press(b"o")
    board.wait_for(lambda: not controller.interlock_closed(), 20.0)
    with pytest.raises(InterlockOpen, match="interlock is open"):
        controller.laser_on()
    assert board.count("laser", 1) == 0
    # an opening in the dark is latched, too
    board.press(b"c")
    board.wait_for(controller.interlock_closed, 20.0)
    with pytest.raises(CommandRefused, match="trip 1, INTERLOCK, is not acknowledged"):
        controller.laser_on()
    controller.acknowledge(1)
    assert controller.next_error()[0] == 102
    assert [str(event) for event in controller.take_events()] != []
    while controller.next_error()[0]:
        pass
    controller.laser_on()
    board.press(b"o")
    board.wait_for(lambda: board.outputs()["laser"][0] == 0, 20.0)
    status = controller.heartbeat()
    assert (status.trip, status.laser_on, status.interlock_closed) == ("INTERLOCK", False, False)
    assert controller.next_error()[0] == 102
    assert [event.detail for event in controller.take_events()] == ["INTERLOCK"]
    # Closing the interlock again lights nothing.
    board.press(b"c")
    board.wait_for(controller.interlock_closed, 20.0)
    assert board.outputs()["laser"][0] == 0


@OF_THE_HOST
def test_power_above_the_configured_limit_is_not_even_sent(board: Board) -> None:
    controller = opened(board)
    for power_w in (MAX_W * 1.000001, -1e-9, math.nan, math.inf):
        with pytest.raises(PowerLimit, match="max_power_w"):
            controller.set_laser_power_w(power_w)
    controller.set_laser_power_w(MAX_W)
    controller.laser_on()
    assert board.outputs()["laser"][1] <= MAX_W


def test_lines_without_a_session_may_ask_but_not_act_and_every_one_is_answered(board: Board) -> None:
    with board.terminal() as line:
        # typed by hand
        line.write(b"*IDN?\r\n")
        assert line.readline() == f"OK optical-pendulum-rig,controller,TEST0001,{VERSION}\r\n".encode()
        line.write(b"laser:power:limit?\n")
        assert line.readline() == b"OK 0.001\r\n"
        line.write(b"LAS:STAT ON\n")
        assert line.readline().startswith(b"!NAK")
        line.write(b"SYST:ERR?\n")
        assert line.readline() == b'OK -101,"Invalid character or checksum"\r\n'
        # sent by a program
        for tag, command in enumerate(("LAS:STAT ON", "MAGN ON", "STAR:PULS 10", "CLAM ON", "BRAK ON"), 1):
            line.write(encode(tag, command))
            assert b"ERR -203" in line.readline()
        assert not any(board.count(name, 1) for name in ("laser", "magnet", "starter", "clamp", "brake"))
        # an endless line is cut, and the next one read
        line.write(b"x" * 5000 + b"\n")
        assert line.readline().startswith(b"!NAK")
        line.write(encode(9, "*IDN?"))
        assert line.readline().startswith(b"#9 OK")

        def errors(first_tag: int, count: int) -> list[int]:
            codes = []
            for tag in range(first_tag, first_tag + count):
                line.write(encode(tag, "SYST:ERR?"))
                codes.append(int(line.readline().split(b" ")[2].split(b",")[0]))
            return codes

        assert errors(10, 7) == [-203] * 5 + [-363, 0]
        # errors beyond the queue are not silent
        for tag in range(20, 50):
            line.write(encode(tag, "NO:SUCH"))
            assert b"ERR -113" in line.readline()
        assert errors(50, 29) == [-113] * 15 + [-350] + [0] * 13
        # a repeated line is answered again, but done once
        line.write(encode(80, "SYST:SESS A,5000"))
        line.readline()
        replies = []
        for _ in range(3):
            line.write(encode(81, "STAR:PULS 50"))
            replies.append(line.readline())
            board.wait_for(lambda: board.outputs()["starter"] == [0], 20.0)
        assert replies[0].startswith(b"#81 OK")
        assert replies == replies[:1] * 3
    assert board.count("starter", 1) == 1


def test_reset_in_mid_command_is_noticed_and_nothing_is_done_twice(wired: Board) -> None:
    controller = opened(wired, watchdog_s=5.0)
    controller.hold()
    seen: list[bytes] = []

    def reset_when_it_comes(data: bytes) -> bytes:
        seen.append(data)
        if len(seen) == 1:
            # The board does it, its reply is lost and it is reset before the host asks again.
            wired.press(b"r")
        return data

    wired.wire.to_board = reset_when_it_comes
    wired.wire.to_host = lambda data: data if b"!BOOT" in data else b""
    with pytest.raises((ControllerReset, ReplyTimeout)):
        controller.starter_pulse(0.02)
    wired.wire.to_host = lambda data: data
    wired.wait_for(lambda: wired.count("boot", 1) == 2, 20.0)
    with pytest.raises(ControllerReset):
        controller.heartbeat()
    assert wired.count("starter", 1) <= 1
    controller.open()
    assert controller.heartbeat().trip == "NONE"
    assert wired.outputs()["magnet"] == [0]


@pytest.mark.parametrize("direction", ["to_board", "to_host"])
def test_junk_half_lines_and_losses_are_survived(wired: Board, direction: str) -> None:
    controller = opened(wired, watchdog_s=5.0, timeout_s=0.15, retries=10)
    turn = 0

    def spoil(data: bytes) -> bytes:
        nonlocal turn
        turn += 1
        match turn % 7:
            case 1:
                return bytes(range(256)) + data
            case 2:
                return data[: len(data) // 2]
            case 3:
                return data.replace(b"4", b"5")
            case 4:
                return b"\x03\x04\x00\xff\n\n" + data
            case _:
                return data

    setattr(wired.wire, direction, spoil)
    powers = [1e-6 * (1 + i) for i in range(40)]
    controller.laser_on()
    for power_w in powers:
        controller.set_laser_power_w(power_w)
    # with repetitions
    assert turn > len(powers) + 5
    lit = [row[2][1] for row in wired.events() if row[1] == "laser" and row[2][0] == 1][1:]
    # Each one arrived, once, unspoilt and in order, whatever the line did.
    assert lit == pytest.approx(powers, rel=2e-6)
    setattr(wired.wire, direction, lambda data: data)


@OF_THE_HOST
def test_a_late_reply_is_not_taken_for_a_fresh_one(wired: Board) -> None:
    controller = opened(wired, watchdog_s=5.0, timeout_s=2.0, retries=0)
    held: list[bytes] = []
    wire = wired.wire
    wire.to_host = lambda data: held.append(data) or b""  # type: ignore[func-returns-value]
    with pytest.raises(ReplyTimeout, match="no reply to LAS:POW"):
        controller.set_laser_power_w(0.0007)
    wire.to_host = lambda data: data
    wire.inject(b"".join(held))
    assert controller.environment() == AmbientReading(20.125, 45.5, 101325.0)


def test_unplugged_is_a_lost_port_on_read_and_on_write(wired: Board) -> None:
    controller = opened(wired)
    wired.wire.unplug()
    with pytest.raises(PortLost, match="check the cable"):
        controller.heartbeat()


@OF_THE_HOST
@pytest.mark.parametrize(
    "answer",
    [b"THORLABS,ITC4001,M00123,1.8\r\n", b"Syntax error: illegal command\r", b"$GPGGA,123519,4807\r\n", b""],
)
def test_wrong_device_is_not_taken_for_the_controller(wired: Board, answer: bytes) -> None:
    wired.wire.to_board = lambda data: b""
    wire = wired.wire
    controller = Controller(settings_for(wired.port, timeout_s=0.1, retries=1), MAX_W)

    def other_device(data: bytes) -> bytes:
        if data.strip():
            wire.inject(answer)
        return b""

    wired.wire.to_board = other_device
    with pytest.raises(ReplyTimeout, match="check port") as raised:
        controller.open()
    if answer.endswith(b"\n"):
        assert answer.strip().decode()[:10] in str(raised.value)


@OF_THE_HOST
def test_another_instrument_with_our_framing_is_named(wired: Board) -> None:
    wire = wired.wire

    def other(data: bytes) -> bytes:
        if b"*IDN?" in data:
            body = b"#" + data.split(b"#")[1].split(b" ")[0] + b" OK somebody,else,1,1.0"
            wire.inject(body + b"*%04X\n" % checksum(body))
        return b""

    wire.to_board = other
    controller = Controller(settings_for(wired.port), MAX_W)
    with pytest.raises(DeviceError, match="'somebody,else,1,1\\.0' answers there"):
        controller.open()


def test_a_relay_that_does_not_do_what_it_was_told_trips(board: Board) -> None:
    controller = opened(board, watchdog_s=5.0)
    controller.set_laser_power_w(0.0005)
    controller.laser_on()
    board.press(b"p")
    board.wait_for(lambda: board.outputs()["laser"][0] == 0, 30.0)
    status = controller.heartbeat()
    assert (status.laser_on, status.trip) == (False, "OUTPUT")
    assert controller.next_error() == (103, "Tripped; OUTPUT")


NUMBERS = st.one_of(
    st.floats(width=64).map(repr),
    st.floats(0.0009, 0.0011).map(repr),
    st.sampled_from(
        ["nan", "inf", "-inf", "1e-3", "1.0000001e-3", "1e400", "0x1p-3", "1_0", "", "-0.0", "1,0"]
    ),
)
COMMANDS = st.one_of(
    st.just("LAS:STAT ON"),
    st.integers(0, 20).map(lambda number: f"SYST:TRIP:ACK {number}"),
    NUMBERS.map(lambda n: f"LAS:POW {n}"),
    NUMBERS.map(lambda n: f"las:power:limit {n}"),
    st.sampled_from(
        [
            "LAS:STAT ON",
            "LAS:STAT OFF",
            "LASER:STATE 1",
            "SYST:SAFE",
            "*RST",
            "SYST:HEAR?",
            "INT?",
            "SYST:SESS B,5000",
            "SYST:SESS C,1e9",
            "SYST:SESS:END",
        ]
    ),
    st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters="#!"), max_size=40),
)
SENDINGS = st.one_of(
    st.tuples(st.just("command"), COMMANDS),
    st.tuples(st.just("bytes"), st.binary(max_size=40)),
    st.tuples(st.just("interlock"), st.booleans()),
)


@pytest.mark.slow
def test_no_power_above_the_stored_limit_whatever_is_sent(board: Board) -> None:
    tag = 0

    with board.terminal() as line:

        def ask(command: str) -> bytes:
            nonlocal tag
            tag = tag % 65535 + 1
            line.write(b"\n" + encode(tag, command))
            while not (reply := line.readline()).startswith(b"#%d " % tag):
                assert reply, f"no answer to {command}"
            return reply

        # a limit that is lowered lowers the light that is on
        for command in ("SYST:SESS A,5000", "LAS:POW 1e-3", "LAS:STAT ON", "LAS:POW:LIM 5e-4"):
            ask(command)
        assert board.outputs()["laser"] == [1, 0.0005]
        ask("LAS:POW:LIM 1e-3")
        ask("SYST:SESS:END")

        examples = 150 if isinstance(board, SteppedBoard) else 40

        @settings(max_examples=examples, suppress_health_check=list(HealthCheck), database=None)
        @given(st.lists(SENDINGS, min_size=1, max_size=12))
        @example(
            [("command", "LAS:STAT ON"), ("command", "LAS:POW 1e-3"), ("command", "LAS:POW 1.0000001e-3")]
        )
        def check(sendings: list[tuple[str, object]]) -> None:
            ask("SYST:SESS A,5000")
            latched = ask("SYST:TRIP?").split()[2].split(b",")[0].decode()
            ask(f"SYST:TRIP:ACK {latched}")
            before = len(board.events())
            for kind, what in sendings:
                if kind == "command":
                    assert isinstance(what, str)
                    ask(what)
                elif kind == "bytes":
                    assert isinstance(what, bytes)
                    line.write(what)
                else:
                    board.press(b"c" if what else b"o")
            ask("SYST:SESS:END")
            board.press(b"c")
            for _, name, values in board.events()[before:]:
                if name == "laser":
                    assert 0.0 <= values[1] <= 0.001
            assert board.outputs()["laser"][0] == 0

        check()
    # The property is not empty: it has been lit on the way, also at the limit itself.
    assert board.count("laser", 1) > 2
    assert any(row[1] == "laser" and row[2] == [1, 0.001] for row in board.events())


def latched(controller: Controller) -> tuple[int, str, bool]:
    latch = controller.heartbeat().latch
    return (0, "NONE", False) if latch is None else (latch.number, latch.cause, latch.lit)


def tripped(board: Board, controller: Controller, key: bytes, *, lit: bool) -> None:
    if lit:
        controller.laser_on()
    board.press(key)
    board.wait_for(lambda: latched(controller)[0] > 0, 20.0)


@pytest.mark.parametrize("lit", [True, False])
def test_a_trip_is_latched_over_sessions_until_its_number_is_acknowledged(board: Board, lit: bool) -> None:
    controller = opened(board, watchdog_s=5.0)
    tripped(board, controller, b"o", lit=lit)
    with pytest.raises(CommandRefused, match="interlock open"):
        controller.acknowledge(1)
    board.press(b"c")
    board.wait_for(controller.interlock_closed, 20.0)
    controller.close()
    another = opened(board, watchdog_s=5.0)
    assert another.earlier_latch is not None
    assert (another.earlier_latch.number, another.earlier_latch.cause) == (1, "INTERLOCK")
    assert latched(another) == (1, "INTERLOCK", lit)
    for number in (0, 2):
        with pytest.raises(CommandRefused, match="trip 1 is latched"):
            another.acknowledge(number)
    with pytest.raises(CommandRefused, match="trip 1, INTERLOCK, is not acknowledged"):
        another.laser_on()
    another.acknowledge(1)
    assert latched(another)[0] == 0
    assert board.outputs()["laser"][0] == 0
    another.laser_on()
    assert board.outputs()["laser"][0] == 1


def test_a_reset_keeps_what_was_latched(board: Board) -> None:
    controller = opened(board, watchdog_s=5.0)
    tripped(board, controller, b"o", lit=True)
    board.press(b"c")
    board.press(b"r")
    board.wait_for(lambda: board.count("boot", 1) == 2, 20.0)
    with pytest.raises(ControllerReset):
        controller.heartbeat()
    controller.open()
    assert controller.earlier_latch is not None
    assert controller.earlier_latch.number >= 1
    with pytest.raises(CommandRefused, match="is not acknowledged"):
        controller.laser_on()


def test_the_boards_button_acknowledges_if_it_is_let_go_and_held(board: Board) -> None:
    controller = opened(board, watchdog_s=5.0)
    # one that is stuck does nothing
    board.press(b"k")
    tripped(board, controller, b"o", lit=True)
    board.press(b"c")
    board.wait_for(controller.interlock_closed, 20.0)
    begun_ms = controller.heartbeat().uptime_ms
    board.wait_for(lambda: controller.heartbeat().uptime_ms > begun_ms + 1000, 20.0)
    assert latched(controller) == (1, "INTERLOCK", True)
    board.press(b"K")
    begun_ms = controller.heartbeat().uptime_ms
    board.wait_for(lambda: controller.heartbeat().uptime_ms > begun_ms + 100, 20.0)
    board.press(b"k")
    board.wait_for(lambda: latched(controller)[0] == 0, 20.0)
    assert board.outputs()["laser"][0] == 0


def test_light_that_a_photodiode_sees_though_off_is_latched(board: Board) -> None:
    controller = opened(board, watchdog_s=5.0)
    board.press(b"d")
    controller.set_laser_power_w(0.0005)
    board.press(b"l")
    board.wait_for(lambda: latched(controller)[1] == "OUTPUT", 20.0)
    with pytest.raises(CommandRefused, match="light is seen"):
        controller.acknowledge(latched(controller)[0])
    board.press(b"d")
    board.wait_for(lambda: controller.heartbeat().light_seen is False, 20.0)
    controller.acknowledge(latched(controller)[0])
    # and none where there should be some
    tripped(board, controller, b"d", lit=True)
    assert latched(controller)[1:] == ("OUTPUT", True)
    controller.close()
