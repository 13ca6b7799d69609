"""Every path to light goes through the rig's permit: found in the code, and each walked with a trip."""

import ast
import json
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rig
from acquisition.camera import Frame
from acquisition.cameras.simulated import SimulatedCamera
from processing.errors import DeviceError
from rig.control import NEEDS_REQUEST, ControlService, LightRefused, Stage, TripCause, run_in_thread
from rig.control.light_permit import LONGEST_PAUSE_S, PROCESSING_ENDED
from rig.control.simulated import SimulatedBoard
from rig.devices import Devices, LightWatch, SessionNews
from rig.devices.acknowledgement import TypedAcknowledgement
from rig.devices.aligning import LivePicture
from rig.instrument import complete
from rig.measure import measure_session, notices, preflight_rig, record_plainly
from rig.measure.notices import PreflightWait
from rig.measure.session_orders import Notes, orders
from rig.prepare.balancing import measure
from rig.settings import Configuration
from rig.view import BalanceView
from tests.rig.command_line import AT_ONCE, CONFIGS, QUICK, configured
from tests.rig.control.instruments import FakeCobolt
from tests.rig.devices.test_laser import configuration
from tests.waiting import until

SOURCES = Path(rig.__file__).parent
LIVE = CONFIGS / "live.toml"

ASKS = {
    # what asks the rig for light; a new name here needs a walk below
    ("prepare/balancing.py", "measure"),
    ("devices/aligning.py", "_light"),
    ("devices/acknowledgement.py", "_light"),
    ("measure/run.py", "_execute"),
    ("measure/session_orders.py", "relight"),
}
SWITCHES = {
    # what gives a device the command, each behind the permit
    ("devices/lit_devices.py", "_light_once", "light"),
    ("devices/laser.py", "light", "enable"),
    ("devices/laser.py", "light", "laser_on"),
    ("control/service.py", "_switch_on", "laser_on"),
    ("control/laser_service.py", "_switch_on", "enable"),
}


def calls(node: ast.AST, inside: str = "") -> Iterator[tuple[str, str, bool]]:
    """Calls of what may light: innermost function, name of what is called, whether it is a method."""
    for child in ast.iter_child_nodes(node):
        within = child.name if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef) else inside
        if isinstance(child, ast.Call):
            called = child.func
            word = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
            if word in ("light", "laser_on", "enable"):
                yield within, word, isinstance(called, ast.Attribute)
        yield from calls(child, within)


def test_nothing_else_lights_and_every_path_is_walked() -> None:
    asking, switching, sending = set(), set(), set()
    for path in SOURCES.rglob("*.py"):
        name, text = path.relative_to(SOURCES).as_posix(), path.read_text("utf-8")
        if name.startswith("control/firmware"):
            continue
        if "LAS:STAT ON" in text:
            sending.add(name)
        if re.search(r"\b(light|laser_on|enable)\(", text):
            for within, word, is_method in calls(ast.parse(text)):
                if is_method and word == "light" and not name.startswith("control/"):
                    asking.add((name, within))
                elif not name.startswith("desk/"):
                    switching.add((name, within, word))
    assert asking == ASKS == {*WALKS, ("devices/aligning.py", "_light")}
    assert switching == SWITCHES
    assert sending == {"control/controller.py"}


@pytest.fixture
def config(tmp_path: Path) -> Configuration:
    quiet = {
        **QUICK,
        **AT_ONCE,
        "session.max_duration_s": "2",
        "session.output": json.dumps(str(tmp_path / "runs")),
        "balance.seconds": "9.1",
        # a machine that stands still for half a second is no trip of its own
        "controller.watchdog_s": "5",
        "controller.heartbeat_s": "0.1",
    }
    return configured(quiet, LIVE)


@pytest.fixture
def lit(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """With which powers the simulated board was ever lit."""
    powers_w: list[float] = []
    usual = SimulatedBoard.set_laser

    def set_laser(board: SimulatedBoard, on: bool, power_w: float) -> None:
        if on and power_w > 0:
            powers_w.append(power_w)
        usual(board, on, power_w)

    monkeypatch.setattr(SimulatedBoard, "set_laser", set_laser)
    return powers_w


@pytest.fixture
def tripped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever opens the rig finds a trip that nobody has acknowledged."""
    usual = Devices._open

    def opened(devices: Devices) -> None:
        usual(devices)
        devices.permit.trip(TripCause.INTERLOCK, "the interlock of the controller opened")

    monkeypatch.setattr(Devices, "_open", opened)


def run(config: Configuration, folder: Path) -> None:
    measure_session(config, LIVE, folder / "session")


def calibrate(config: Configuration, folder: Path) -> None:
    record_plainly(config, LIVE, folder / "plain.mcap", 1.0)


def balance(config: Configuration, folder: Path) -> None:
    config = complete(config)
    with Devices(config) as devices:
        measure(config, devices, lambda _: None, BalanceView(config, None, lambda _: "", lambda _: None))


def preflight(config: Configuration, folder: Path) -> None:
    preflight_rig(config)


def ordered(config: Configuration, folder: Path) -> None:
    with Devices(config) as devices:
        devices.permit.begin()
        orders(devices, Notes(folder, ""), SessionNews())["light"]("")


def typed(config: Configuration, folder: Path) -> None:
    with Devices(config) as devices:
        TypedAcknowledgement(devices)._light()
        devices.light()


WALKS: dict[tuple[str, str], tuple[Callable[[Configuration, Path], None], ...]] = {
    ("prepare/balancing.py", "measure"): (balance,),
    ("devices/acknowledgement.py", "_light"): (typed,),
    ("measure/run.py", "_execute"): (run, calibrate, preflight),
    ("measure/session_orders.py", "relight"): (ordered,),
}


@pytest.mark.parametrize("path", [walk for walks in WALKS.values() for walk in walks])
def test_after_a_trip_no_path_lights(
    config: Configuration,
    tmp_path: Path,
    lit: list[float],
    tripped: None,
    path: Callable[[Configuration, Path], None],
) -> None:
    # on a busy machine the controller's watchdog may add a trip
    with pytest.raises(LightRefused, match=r"trip \d+ \((INTERLOCK|WATCHDOG)\)"):
        path(config, tmp_path)
    assert lit == []


@contextmanager
def live_picture(config: Configuration) -> Iterator[tuple[LivePicture, Devices]]:
    """A live picture in a thread, which must end without an error."""
    with Devices(config) as devices, devices.camera(config) as opened:
        picture = LivePicture(config, devices)
        showing = run_in_thread(picture.show, opened)
        try:
            yield picture, devices
        finally:
            picture.press("q")
            showing.result(30.0)


def test_after_a_trip_the_live_picture_lives_in_the_dark(
    config: Configuration, lit: list[float], tripped: None
) -> None:
    with live_picture(config) as (picture, _):
        until(lambda: picture.news.picture() is not None)
        assert "trip 1 (INTERLOCK)" in picture.note
        assert lit == []


def test_light_that_was_asked_for_before_light_off_does_not_come_after_it(
    config: Configuration, monkeypatch: pytest.MonkeyPatch, lit: list[float]
) -> None:
    """The picture hangs meanwhile; then the trip is acknowledged, which lights nothing."""
    runs = Event()
    runs.set()
    usual = SimulatedCamera.read

    def read(camera: SimulatedCamera, timeout_s: float) -> Frame | None:
        runs.wait(20.0)
        return usual(camera, timeout_s)

    def shown() -> int:
        found = picture.news.picture()
        return 0 if found is None else found.number

    monkeypatch.setattr(SimulatedCamera, "read", read)
    with live_picture(config) as (picture, devices):
        until(lambda: len(lit) == 1 and shown() > 0)
        runs.clear()
        asked = run_in_thread(picture.orders["light"], "")
        until(lambda: picture.requests.pending)
        devices.light_off("the desk")
        until(lambda: devices.safety().light == "off")
        trip = devices.permit.latched
        assert trip is not None
        with pytest.raises(LightRefused, match="acknowledge it first"):
            picture.orders["light"]("")
        devices.acknowledge(trip.number, "the desk")
        runs.set()
        assert NEEDS_REQUEST in asked.result(20.0)
        seen = shown()
        until(lambda: shown() > seen + 3)
        assert len(lit) == 1
        picture.orders["light"]("")
        until(lambda: len(lit) == 2)


@pytest.mark.parametrize("silent", ["picture_request_s", "news_request_s"])
def test_a_live_picture_that_nobody_sees_at_a_desk_goes_dark_until_light_is_asked_for(
    config: Configuration, monkeypatch: pytest.MonkeyPatch, lit: list[float], silent: str
) -> None:
    """No browser fetches it, or the desk is frozen or gone."""
    monkeypatch.setattr("rig.devices.aligning._MAX_UNSEEN_S", 0.5)
    monkeypatch.setattr("rig.devices.aligning._MAX_SILENCE_S", 0.5)
    with live_picture(config) as (picture, devices):
        told = picture.news
        until(lambda: len(lit) == 1 and not devices.darkness())
        told.news_request_s = told.picture_request_s = time.monotonic() + 60.0
        setattr(told, silent, time.monotonic())
        until(lambda: devices.confirmed_dark)
        until(lambda: "nobody has looked" in told.news()["state"]["dark"])
        assert devices.permit.latched is None
        picture.orders["light"]("")
        until(lambda: len(lit) == 2)


def a_slow_laser(monkeypatch: pytest.MonkeyPatch) -> tuple[Event, Event]:
    """A laser that takes its power when it may; set once it is waited for, and to be set to let it go on."""
    began, answers = Event(), Event()
    usual = ControlService.set_laser_power_w

    def slow(service: ControlService, power_w: float) -> object:
        began.set()
        answers.wait(20.0)
        return usual(service, power_w)

    monkeypatch.setattr(ControlService, "set_laser_power_w", slow)
    return began, answers


@pytest.mark.parametrize("asked", [False, True])
def test_lighting_that_still_waits_for_a_device_is_outdated_by_light_off(
    config: Configuration, monkeypatch: pytest.MonkeyPatch, lit: list[float], asked: bool
) -> None:
    """A device is waited for by seconds; who acknowledges meanwhile has not asked for light."""
    began, answers = a_slow_laser(monkeypatch)
    with Devices(config) as devices:
        ask = partial(devices.light, on_request=asked)
        lighting = [run_in_thread(ask)]
        assert began.wait(10.0)
        # that of a desk, while the run's is under way
        lighting.append(run_in_thread(ask))
        until(lambda: devices.permit.expects_light)
        devices.light_off("the desk")
        until(lambda: devices.safety().light == "off")
        devices.acknowledge(1, "the desk")
        answers.set()
        for light in lighting:
            with pytest.raises(DeviceError, match="until a person asks for light"):
                light.result(20.0)
        assert lit == []
        assert devices.light(on_request=True) == "laser on, 0.9 mW"


def test_lighting_that_still_waits_for_a_device_is_outdated_by_the_end_of_the_run(
    config: Configuration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lit: list[float]
) -> None:
    """Somebody at a desk asks for light just when a run that has waited in the dark comes to its end."""
    began, answers = a_slow_laser(monkeypatch)
    with Devices(config) as devices:
        devices.permit.begin()
        lighting = run_in_thread(orders(devices, Notes(tmp_path, ""), SessionNews())["light"], "")
        assert began.wait(20.0)
        devices.darken("the run has ended")
        answers.set()
        with pytest.raises(LightRefused, match=PROCESSING_ENDED):
            lighting.result(20.0)
        assert lit == []
        assert not devices.permit.expects_light
        # the next run lights by itself
        assert devices.light() == "laser on, 0.9 mW"


def test_asked_for_after_the_last_run_the_order_promises_no_light(
    config: Configuration, tmp_path: Path
) -> None:
    with Devices(config) as devices:
        light = orders(devices, Notes(tmp_path, ""), SessionNews())["light"]
        assert light("") == "the next run lights the laser"
        devices.lights_again = False
        with pytest.raises(LightRefused, match="no run follows that would light the laser"):
            light("")


def test_the_last_run_of_a_session_is_followed_by_no_light(
    config: Configuration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When the laser is told off the camera is still looked at, and the channel still takes orders."""
    usual, seen = Devices.confirm_dark_by_frames, list[Devices]()

    def confirm(devices: Devices, camera: Any) -> None:
        with pytest.raises(LightRefused, match="no run follows that would light the laser; start one"):
            orders(devices, Notes(tmp_path, ""), SessionNews())["light"]("")
        seen.append(devices)
        usual(devices, camera)

    monkeypatch.setattr(Devices, "confirm_dark_by_frames", confirm)
    # a machine that stands still for longer between two runs is no trip of its own
    for stage in Stage:
        monkeypatch.setitem(LONGEST_PAUSE_S, stage, 60.0)
    run(config.model_copy(update={"session": config.session.model_copy(update={"runs": 2})}), tmp_path)
    assert len(seen) == 1


class Loop:
    """The interlock of the simulated board."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.closed = True
        monkeypatch.setattr(SimulatedBoard, "interlock_closed", lambda _: self.closed)

    def open_and_close(self, devices: Devices) -> None:
        self.closed = False
        until(lambda: devices.permit.latched is not None)
        self.closed = True
        until(lambda: devices.safety().interlock == "closed")


@pytest.mark.parametrize("when", ["before", "during", "after"])
def test_a_trip_is_acknowledged_and_then_asked_for_light(
    config: Configuration, monkeypatch: pytest.MonkeyPatch, lit: list[float], when: str
) -> None:
    loop = Loop(monkeypatch)
    with Devices(config) as devices:
        if when != "before":
            devices.light()
            assert len(lit) == 1
        if when == "after":
            devices.darken()
        loop.open_and_close(devices)
        trip = devices.safety().trip
        assert trip is not None
        assert trip.lit == (when == "during")
        before = len(lit)
        with pytest.raises(LightRefused):
            devices.light()
        with pytest.raises(DeviceError, match="latched is trip 1"):
            devices.acknowledge(2, "test")
        devices.acknowledge(1, "test")
        time.sleep(0.3)
        assert len(lit) == before
        assert not devices.safety().refusal
        with pytest.raises(LightRefused, match="until a person asks for light"):
            devices.light()
        devices.light(on_request=True)
        assert len(lit) == before + 1


def test_a_session_that_waits_in_the_dark_does_not_light_after_a_trip(
    config: Configuration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lit: list[float]
) -> None:
    """Between two tries of a run whose preflight said no-go the door is opened for a moment."""
    loop = Loop(monkeypatch)
    opened: list[Devices] = []
    usual = Devices._open

    def noted(devices: Devices) -> None:
        usual(devices)
        opened.append(devices)

    monkeypatch.setattr(Devices, "_open", noted)

    never = config.preflight.model_copy(update={"when": "always", "min_temperature_c": 35.0})
    config = config.model_copy(update={"preflight": never})
    patient = never.model_copy(update={"wait_max_s": 3600.0})
    waiting = PreflightWait("series", patient)
    clock: Any = SimpleNamespace(monotonic=time.monotonic, sleep=lambda _s: loop.open_and_close(opened[-1]))
    monkeypatch.setattr(notices, "time", clock)
    with pytest.raises(LightRefused, match="nobody has acknowledged it"):
        measure_session(config, LIVE, tmp_path / "series", waiting=waiting)
    assert len(lit) == 1


def test_without_a_controller_the_state_is_the_rigs_and_outlives_the_program(
    tmp_path: Path, instrument: FakeCobolt
) -> None:
    config = configuration("cobolt", instrument.port)
    with Devices(config, tmp_path) as devices:
        devices.light()
        with pytest.raises(DeviceError, match="in use by process"), Devices(config):
            pass
        instrument.interlock_closed = False
        until(lambda: devices.permit.latched is not None)
    instrument.interlock_closed = True
    instrument.highest_lit = 0.0
    with Devices(config, tmp_path) as devices:
        until(lambda: devices.safety().interlock == "closed")
        with pytest.raises(LightRefused, match="trip 1"):
            devices.light()
        assert instrument.highest_lit == 0.0
        devices.acknowledge(1, "test")
        # opened after the trip: that it was opened is the asking
        devices.light()
        # killed: nothing is closed
        devices.state._lock_file.close()  # type: ignore[union-attr]
        with Devices(config, tmp_path) as after:
            trip = after.permit.latched
            assert trip is not None
            assert (trip.number, trip.cause) == (2, TripCause.WATCHDOG)


@pytest.mark.parametrize("what", ["panel", "stall"])
def test_what_has_gone_dark_by_itself_is_lit_by_no_later_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, instrument: FakeCobolt, what: str
) -> None:
    """Somebody switches the laser off at its panel; or frames stall for a while, and go on."""
    config = configuration("cobolt", instrument.port)
    with Devices(config, tmp_path) as devices, monkeypatch.context() as stalls:
        watch = LightWatch(devices)
        devices.light()
        if what == "stall":
            stalls.setitem(LONGEST_PAUSE_S, Stage.CAMERA, 0.0)
        else:
            instrument.light(False)
        until(lambda: not instrument.on)
        until(lambda: watch.look() is None or bool(watch.alarm))
        devices.darken("the run has ended")
    # another run, series or program
    with Devices(config, tmp_path) as devices:
        devices.wait_for_reports()
        with pytest.raises(LightRefused, match=r"trip 1 \(WATCHDOG\): the laser went dark"):
            devices.light()
        devices.acknowledge(1, "test")
        devices.light(on_request=True)
        assert instrument.on


def test_a_spot_that_is_still_seen_cannot_be_acknowledged(config: Configuration) -> None:
    with Devices(config) as devices:
        spot = devices.permit.spot
        spot.exposure_s = -0.45  # frames count 0.1 s after the command
        bright, dark = (np.full((64, 64), 8, np.uint8) for _ in range(2))
        bright[20:40, 20:40] = 200

        def shown(image: NDArray[np.uint8]) -> None:
            spot.examine(image)
            devices.compare()

        devices.light()
        until(lambda: shown(bright) is None and spot.visible is True)
        devices.darken()
        until(lambda: shown(bright) is None and devices.permit.latched is not None)
        assert devices.safety().light == "commanded off, but its output or its light is seen to be on"
        with pytest.raises(DeviceError, match="the camera still sees its spot"):
            devices.acknowledge(1, "test")
        until(lambda: shown(dark) is None and spot.confirms)
        devices.acknowledge(1, "test")


def test_a_control_thread_that_hangs_is_unknown_and_not_lit(
    config: Configuration, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Devices(config) as devices:
        devices.light()
        until(lambda: devices.safety().light == "on")
        now_ns = time.monotonic_ns
        # for the host's reader of states two and a half seconds without a word have passed
        import rig.devices.laser as reader

        late: Any = type("Late", (), {"monotonic_ns": staticmethod(lambda: now_ns() + 2_500_000_000)})
        monkeypatch.setattr(reader, "time", late)
        safety = devices.safety()
        assert (safety.light, safety.interlock) == ("unknown, nothing was heard for more than 2 s", "unknown")
        assert safety.light_age_s > 2.0
        assert "laser on" not in devices.safety().devices_text
        assert devices.darkness().startswith("unknown")
        monkeypatch.undo()
