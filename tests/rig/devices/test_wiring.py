"""What is said of light and controller where one of them is not there, or is another's."""

import re
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from rig.control import ControlService, LightRefused
from rig.control.protocol import ControllerIdentity
from rig.control.serial_port import PortLost, SerialPort
from rig.devices import Devices
from rig.settings import Configuration, validate_configuration
from tests.rig.command_line import CONFIGS, SMALL, Done, rig, set_words
from tests.rig.control.instruments import FakeCobolt
from tests.rig.control.wires import FirmwareBoard
from tests.rig.known_rig import known
from tests.rig.made_up import speaking_port
from tests.waiting import until

# a port that nobody answers is waited for
pytestmark = pytest.mark.timeout(120)
LIVE = CONFIGS / "live.toml"
WITHOUT = "--set controller.kind=none --set laser.kind=none"
SHORT = {**SMALL, "session.max_duration_s": "2"}
NEITHER = {"controller.kind": "none", "laser.kind": "none"}


def run_live(folder: Path, **keys: str) -> tuple[Done, str]:
    """What became of a run with these keys (`__` for a dot), and its line that names a fault."""
    stated = {**SHORT, **{key.replace("__", "."): value for key, value in keys.items()}}
    done = rig("run", LIVE, "-o", "out", *set_words(stated), cwd=folder)
    return done, "".join(line for line in done.stderr.splitlines() if line.startswith("rig: "))


@pytest.mark.parametrize(
    ("laser", "key", "instead"),
    [
        ({"kind": "controller"}, "kind", "laser.kind to none, and switch it by hand"),
        (
            {"kind": "obis", "port": "/dev/nix", "interlock": "controller"},
            "interlock",
            "laser.interlock to own",
        ),
    ],
)
def test_a_laser_of_no_controller_is_refused_and_nothing_is_confirmed(
    tmp_path: Path, laser: dict[str, str], key: str, instead: str
) -> None:
    keys = {**SHORT, "controller.kind": "none", **{f"laser.{name}": value for name, value in laser.items()}}
    said = f"laser.{key} = 'controller', but controller.kind = 'none': nothing switches the laser"
    remedy = f"set controller.kind to serial or simulated, or {instead}"
    for words in (
        ("run", LIVE, "-o", "out"),
        ("light", "show", LIVE),
        ("doctor", LIVE, "--preflight"),
        ("desk", LIVE),
    ):
        done = rig(*words, *set_words(keys), cwd=tmp_path)
        assert (done.returncode, done.stderr) == (2, f"rig: {said}; {remedy}\n")
    assert not any(tmp_path.iterdir())
    doctor = rig("doctor", LIVE, "--json", *set_words(keys), cwd=tmp_path)
    assert doctor.returncode == 1
    assert f'"reason": "{said}", "remedy": "{remedy}"' in doctor.stdout


def test_a_start_by_a_controller_that_is_not_there_is_refused_before_anything_warms_up(
    tmp_path: Path,
) -> None:
    done, line = run_live(tmp_path, **NEITHER)
    assert done.returncode == 2
    assert "start.way = 'starter' needs a controller" in line
    assert "warm-up" not in done.stderr
    doctor = rig("doctor", LIVE, "--json", *set_words(SHORT | NEITHER), cwd=tmp_path)
    assert doctor.returncode == 1
    for key in ("start.way = 'starter'", "environment_sensor.kind = 'controller'"):
        assert f"{key}, but controller.kind = 'none'" in doctor.stdout


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is wrong with the first try to open a device is taken at once, as the last one would be."""
    usual = ControlService.wait_open

    def wait_open(service: ControlService, _timeout_s: float = 0.0) -> ControllerIdentity:
        until(lambda: bool(service.snapshot.last_error))
        return usual(service, 0.0)

    monkeypatch.setattr(ControlService, "wait_open", wait_open)
    monkeypatch.setattr("rig.devices.laser._MAX_ANSWER_S", 2.0)
    monkeypatch.setattr("rig.devices.lit_devices._MAX_LASER_CONFIRM_S", 0.2)


@pytest.mark.parametrize(
    ("says", "echoes", "heard"),
    [
        (b"", False, "it is silent"),
        (b"sensor 512\r\n", False, "it sends 'sensor 512', which"),
        (b"", True, "it sends '#"),
        (b"\xff\x00\xf7", False, "it sends 'ÿ\\x00"),
        (b">>> ", False, "it sends '>>> "),
    ],
    ids=["silent", "chatty", "echo", "another baud rate", "prompt without a line's end"],
)
def test_a_board_with_another_program_is_told_what_it_lacks(
    tmp_path: Path, impatient: None, says: bytes, echoes: bool, heard: str
) -> None:
    with speaking_port(lambda heard: says + heard * echoes) as port:
        known(port)
        done, line = run_live(tmp_path, controller__kind="serial", controller__port=port)
    assert done.returncode == 1
    assert heard in line
    assert "this program's firmware (docs/controller.md, Flashing)" in line
    assert "such as an Arduino, set controller.kind = 'none' and laser.kind = 'none'" in line
    assert line.endswith(f"{WITHOUT} --set 'start.way=at once'")


def test_a_port_that_is_not_there_is_said_once_with_those_that_are(tmp_path: Path, impatient: None) -> None:
    keys = {"controller.kind": "serial", "controller.port": "/dev/ttyWRONG", "start.way": "at once"}
    _, line = run_live(tmp_path, **keys)
    assert line.startswith("rig: /dev/ttyWRONG: cannot open the serial port: No such file or directory; ")
    assert line.count("ttyWRONG") == 1
    assert line.count("No such file") == 1
    assert "present are /dev/" in line or "this computer has no serial port" in line
    assert line.endswith(f"; the camera is simulated, and runs without: {WITHOUT}")
    doctor = rig("doctor", LIVE, *set_words(SHORT | keys), cwd=tmp_path).stdout
    (said,) = (text for text in doctor.replace("\n", " ").split("NO-GO ") if text.startswith("controller: "))
    assert said.count("ttyWRONG") == 1
    assert WITHOUT in said


def test_a_laser_that_is_not_there_says_so_once_and_how_to_do_without(
    tmp_path: Path, impatient: None
) -> None:
    known("/dev/ttyWRONG")
    keys = {"controller.kind": "none", "start.way": "at once", "preflight.when": "never"}
    keys |= {"laser.kind": "obis", "laser.port": "/dev/ttyWRONG", "laser.power_w": "0.0005"}
    done, line = run_live(tmp_path, **keys)
    assert line.count("ttyWRONG") == 1
    assert line.endswith("; the camera is simulated, and runs without: --set laser.kind=none")
    assert "confirmed" not in done.stderr


def test_a_port_that_another_program_has_is_called_that() -> None:
    with (
        speaking_port(lambda _: b"") as port,
        closing(SerialPort(port)),
        pytest.raises(PortLost, match="another program has it open; end"),
    ):
        SerialPort(port)


def test_the_printed_line_is_one_that_runs(tmp_path: Path) -> None:
    keys = {"simulation.real_time": "false", "start.way": "at once", "simulation.release.way": "let go"}
    done, _ = run_live(tmp_path, **keys, **NEITHER, **{"controller.port": "/dev/ttyWRONG"})
    assert "time limit of 2 s reached" in done.stderr
    assert "confirmed" not in done.stderr


def of_parts(board: FirmwareBoard, laser: dict[str, Any], **controller: float) -> Configuration:
    tree = {
        "camera": {"driver": "simulated"},
        "laser": {"max_power_w": 0.001, "power_w": 0.0005, **laser},
        "controller": {"kind": "serial", "port": board.port, **controller},
    }
    return validate_configuration(tree, "test").remember_file(
        Path("my rig.toml"), ["laser.kind=x", "session.runs=2"]
    )


def test_a_controller_that_has_only_the_magnet_confirms_no_laser(
    make_board: Callable[..., FirmwareBoard], capsys: pytest.CaptureFixture[str]
) -> None:
    instrument = FakeCobolt()
    laser = {"kind": "cobolt", "port": instrument.port}
    with closing(instrument), Devices(of_parts(make_board(), laser)) as devices:
        devices.light()
        assert instrument.on
    assert capsys.readouterr().err == "laser off, confirmed by the laser\n"


def test_light_off_says_nothing_of_a_laser_that_is_switched_by_hand() -> None:
    config = validate_configuration({"camera": {"driver": "simulated"}}, "test")
    with Devices(config) as devices:
        assert devices.light_off("a test") == "no laser is switched by this program: turn its key"


def test_a_trip_names_the_command_that_acknowledges_it(
    make_board: Callable[..., FirmwareBoard], capsys: pytest.CaptureFixture[str]
) -> None:
    board = make_board()
    with Devices(of_parts(board, {"kind": "controller"})) as devices:
        devices.light()
        devices.light_off("a test")
        with pytest.raises(LightRefused) as refused:
            devices.light()
    command = "rig light acknowledge 'my rig.toml' --set laser.kind=x 1"
    assert command in str(refused.value)
    assert command in capsys.readouterr().err.splitlines()[-1]


def test_a_simulated_rig_that_tripped_is_started_again(tmp_path: Path) -> None:
    keys = {"faults.interlock_opens_at_s": "0.5", "preflight.when": "never", "start.way": "at once"}
    done, _ = run_live(tmp_path, **keys)
    assert done.returncode == 1
    # under load the board's watchdog may add a trip of its own
    assert re.search(
        r"^trip \d \(\w+\): .*: it is a simulated laser: start again$", done.stderr, re.MULTILINE
    )
