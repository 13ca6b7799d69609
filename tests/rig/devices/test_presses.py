"""LIGHT OFF that no order brings to a program: left beside the rig's state, it holds for who lights next."""

import errno
import os
import time
from functools import partial
from pathlib import Path
from threading import Event

import pytest

from acquisition import atomic_write
from processing.errors import DeviceError
from rig.control import LightRefused, TripCause, light_permit, run_in_thread
from rig.control.presses import Presses
from rig.devices import Devices, LightWatch
from rig.measure import acknowledge_trip, show_light
from rig.settings import Configuration
from tests.rig.control.instruments import FakeCobolt
from tests.rig.devices.test_laser import configuration
from tests.waiting import until


@pytest.fixture
def config(instrument: FakeCobolt, tmp_path: Path) -> Configuration:
    return configuration("cobolt", instrument.port, session={"output": str(tmp_path)})


@pytest.fixture
def presses(config: Configuration) -> Presses:
    """Of the desk, which is another program, and has no leave of the one that has the rig."""
    presses = Devices(config).state.presses
    assert presses is not None
    return presses


@pytest.mark.parametrize("when", ["before it starts", "before it lights", "as it lights"])
def test_pressed_while_a_program_starts_nothing_is_lit(
    config: Configuration,
    instrument: FakeCobolt,
    presses: Presses,
    when: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if when == "before it starts":
        presses.press("the desk")
    with Devices(config) as devices:
        devices.wait_for_reports()
        if when == "before it lights":
            presses.press("the desk")
        elif when == "as it lights":
            usual = devices.permit.begin

            def begin() -> None:
                # what is looked at before the command was looked at
                usual()
                presses.press("the desk")

            monkeypatch.setattr(devices.permit, "begin", begin)
        with pytest.raises(LightRefused, match=r"trip 1 \(PERSON\): LIGHT OFF was pressed"):
            devices.light()
        if when == "as it lights":
            monkeypatch.setattr(devices.permit, "begin", usual)
        assert instrument.highest_lit == 0.0
        devices.acknowledge(1, "test")
        assert devices.permit.latched is None
        devices.light(on_request=True)
        assert instrument.on


def test_pressed_while_it_is_lit_it_is_dark_without_any_order(
    config: Configuration, instrument: FakeCobolt, presses: Presses
) -> None:
    with Devices(config) as devices:
        devices.light()
        assert instrument.on
        presses.press("the desk")
        until(lambda: not instrument.on)
        trip = devices.permit.latched
        assert trip is not None
        assert (trip.cause, trip.lit) == (TripCause.PERSON, True)


def test_pressed_while_nobody_has_the_rig_it_is_shown_and_acknowledged(
    config: Configuration, instrument: FakeCobolt, presses: Presses, capsys: pytest.CaptureFixture[str]
) -> None:
    presses.press("the desk")
    assert show_light(config) == 1
    assert "trip 1 (PERSON): LIGHT OFF was pressed at the desk" in capsys.readouterr().out
    assert acknowledge_trip(config, 1) == 0
    assert show_light(config) == 0
    with Devices(config) as devices:
        devices.light()
        assert instrument.on


def test_the_order_and_the_press_are_one_trip_also_after_an_early_acknowledgement(
    config: Configuration, instrument: FakeCobolt, presses: Presses
) -> None:
    with Devices(config) as devices:
        watch = LightWatch(devices)
        devices.light()
        until(lambda: not watch.look() and devices.darkness() == "")
        presses.press("the desk")
        devices.light_off("the desk")
        until(lambda: not instrument.on)
        time.sleep(0.25)
        devices.acknowledge(1, "test")
        end_s = time.monotonic() + 2.0
        while time.monotonic() < end_s:
            watch.look()
            time.sleep(0.05)
        assert watch.alarm
        assert devices.permit.latched is None
        devices.light(on_request=True)
        assert instrument.on


def test_where_the_state_cannot_be_written_nothing_is_lit(
    config: Configuration, instrument: FakeCobolt, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with Devices(config) as devices:
        devices.wait_for_reports()
        with monkeypatch.context() as disk:
            disk.setattr(atomic_write, "replace", full)
            with pytest.raises(LightRefused, match="the rig's state cannot be written: No space left"):
                devices.light()
            assert "cannot be written" in devices.safety().refusal
            assert instrument.highest_lit == 0.0
        devices.light()
        assert instrument.on
        # a trip that only this program knows
        with monkeypatch.context() as disk:
            disk.setattr(atomic_write, "replace", full)
            devices.permit.trip(TripCause.OUTPUT, "it stays lit")
            until(lambda: not instrument.on)
            devices.state._lock_file.close()  # type: ignore[union-attr]
            with Devices(config) as after:
                assert after.permit.latched is not None
                with pytest.raises(DeviceError):
                    after.light(on_request=True)
                assert not instrument.on


def test_a_disk_that_hangs_hears_of_no_press_and_refuses_the_light(
    config: Configuration, instrument: FakeCobolt, presses: Presses, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on = Event()
    usual = Presses.newest

    def hangs(presses: Presses) -> object:
        goes_on.wait(30.0)
        return usual(presses)

    with Devices(config) as devices:
        devices.light()
        monkeypatch.setattr(light_permit, "_MAX_PRESS_CHECK_INTERVAL_S", 0.5)
        monkeypatch.setattr(Presses, "newest", hangs)
        try:
            until(lambda: "LIGHT OFF would not be heard" in devices.darkness())
            until(lambda: not instrument.on)
            asking = run_in_thread(partial(devices.light, on_request=True))
            with pytest.raises(TimeoutError):
                asking.result(0.5)
            assert not instrument.on
        finally:
            goes_on.set()
        asking.exception(20.0)


def test_a_laser_whose_trip_hangs_at_the_disk_still_obeys(
    config: Configuration, instrument: FakeCobolt, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on = Event()
    with Devices(config) as devices:
        devices.light()
        until(lambda: instrument.on)
        monkeypatch.setattr(atomic_write, "replace", lambda *_: goes_on.wait(60.0))
        try:
            instrument.interlock_closed = False
            until(lambda: devices.permit.latched is not None)
            # an instrument that lights again as soon as its interlock is closed
            instrument.interlock_closed = True
            instrument.light(True)
            assert devices.laser is not None
            devices.laser.off().result(10.0)
            assert not instrument.on
        finally:
            goes_on.set()
