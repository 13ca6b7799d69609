"""A run that is read in the caller's thread: its timeout, its end from another thread, its errors."""

import re
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from acquisition import cameras
from acquisition.camera import CameraLost, Frame
from acquisition.cameras.drivers import DRIVERS, settings_models
from acquisition.cameras.reading import CameraRun
from processing.errors import MissingPackage, optional_module

FRAME = Frame(np.zeros((2, 2), np.uint8), 0, -1, 0)


class Waiting:
    """A camera whose frame comes when it is told; counts what is asked of it."""

    def __init__(self) -> None:
        self.asked = threading.Event()
        self.go_on = threading.Event()
        self.in_step = False
        self.ends: list[str] = []

    def step(self, timeout_s: float) -> Frame | None:
        self.in_step = True
        self.asked.set()
        assert self.go_on.wait(10.0)
        self.in_step = False
        return FRAME

    def end(self) -> None:
        assert not self.in_step, "the camera is given back while it is read"
        self.ends.append("end")


def run_in_thread(action: Callable[[], object]) -> tuple[threading.Thread, list[object]]:
    """The running thread and, later, what the action returned."""
    returned: list[object] = []
    thread = threading.Thread(target=lambda: returned.append(action()), daemon=True)
    thread.start()
    return thread, returned


def test_without_a_frame_in_time_it_can_be_read_again() -> None:
    frames = iter([None, None, FRAME])
    reading = CameraRun(lambda _: next(frames), lambda: None)
    with pytest.raises(TimeoutError):
        reading.read(0.0)
    assert reading.read(5.0) is FRAME
    assert reading.delivered == 1
    assert not reading.stopped


def test_a_stop_ends_the_read_of_another_thread_and_then_the_run_once() -> None:
    camera = Waiting()
    reading = CameraRun(camera.step, camera.end)
    reader, returned = run_in_thread(lambda: reading.read(10.0))
    assert camera.asked.wait(10.0)
    assert not reading.stop(0.0), "the camera is still waiting"
    reading.when_ended(lambda: camera.ends.append("close"))
    assert camera.ends == []
    camera.go_on.set()
    reader.join(10.0)
    assert returned == [None], "a frame after stop is not delivered"
    assert reading.delivered == 0
    assert reading.stop(0.0)
    assert camera.ends == ["end", "close"]
    reading.when_ended(lambda: camera.ends.append("late"))
    assert camera.ends == ["end", "close", "late"]


def test_a_stop_that_nobody_reads_ends_the_run_itself() -> None:
    camera = Waiting()
    reading = CameraRun(camera.step, camera.end)
    assert reading.stop(0.0)
    assert camera.ends == ["end"]
    assert reading.read(10.0) is None
    assert not camera.asked.is_set()


def test_an_error_ends_the_run_and_is_said_again() -> None:
    ends: list[str] = []

    def step(timeout_s: float) -> Frame | None:
        raise CameraLost("plug it in again")

    reading = CameraRun(step, lambda: ends.append("end"))
    for _ in range(2):
        with pytest.raises(CameraLost, match="plug it in again"):
            reading.read(10.0)
    assert reading.stopped
    assert ends == ["end"]


def test_settings_of_drivers_that_messages_name_exist() -> None:
    fields = {name: fields_of(name) for name in DRIVERS}
    named = set[tuple[str, str]]()
    for source in Path(cameras.__path__[0]).rglob("*.py"):
        named |= set(re.findall(r"\bcamera\.(\w+)\.(\w+)", source.read_text(encoding="utf-8")))
    settings = {(driver, key) for driver, key in named if driver in fields}
    assert len(settings) > 4
    assert {(driver, key) for driver, key in settings if key not in fields[driver]} == set()


def fields_of(driver: str) -> set[str]:
    return {field for model in settings_models(driver) for field in model.model_fields}


def test_a_missing_package_is_told_by_every_later_read() -> None:
    reading = CameraRun(lambda _: optional_module("no_av", "a film", "av", "video"), lambda: None)
    for _ in range(2):
        with pytest.raises(MissingPackage, match="a film needs av, of the extra video"):
            reading.read(0.0)


@pytest.mark.parametrize("fault", ["import no_such_part", "raise ImportError('no libav')", "1 / 0"])
def test_a_broken_package_is_not_said_to_be_missing(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_av.py").write_text(fault)
    monkeypatch.syspath_prepend(tmp_path)
    said = r"needs av, which is installed but cannot be loaded \(\w+Error: .* --force-reinstall av"
    with pytest.raises(MissingPackage, match=said):
        optional_module("broken_av", "a film", "av", "video")
