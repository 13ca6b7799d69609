"""The rig's own state: it outlives programs, is held by one at a time, and in doubt is latched."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest

from acquisition import atomic_write
from processing.errors import DeviceError
from rig.control import (
    ControllerSettings,
    LaserSettings,
    LatchedTrip,
    SafetyState,
    TripCause,
    rig_state_path,
    run_in_thread,
    safety_state,
)
from rig.control.presses import Presses
from tests.disk_without_locks import NO_LOCKS, without_locks


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """That of a rig which has been used before."""
    path = tmp_path / "states" / "rig.json"
    path.parent.mkdir()
    path.write_text("{}")
    return path


def trip_of(state: SafetyState | Path) -> LatchedTrip:
    """What is latched now, or in the file of a rig which the next program opens."""
    if isinstance(state, Path):
        with SafetyState(state) as opened:
            return trip_of(opened)
    assert state.trip is not None
    return state.trip


def assert_acknowledged_once(path: Path, number: int = 1) -> None:
    """The number is what the next program takes, and the one after it finds nothing."""
    with SafetyState(path) as state:
        state.acknowledge(number)
    with SafetyState(path) as state:
        assert state.trip is None


def test_a_trip_outlives_the_program_and_its_number_grows_over_all_of_them(path: Path) -> None:
    for number in (1, 2, 3):
        with SafetyState(path) as state:
            assert state.latch(TripCause.OUTPUT, "it stays lit", lit=False).number == number
        assert trip_of(path).text == f"trip {number} (OUTPUT): it stays lit"
        with (
            SafetyState(path) as state,
            pytest.raises(DeviceError, match=f"trip {number - 1} cannot be acknowledged: latched is"),
        ):
            state.acknowledge(number - 1)
        assert_acknowledged_once(path, number)


def test_one_program_holds_it(path: Path) -> None:
    with (
        SafetyState(path, "rig run"),
        pytest.raises(DeviceError, match=r"in use by process \d+ \(rig run\): end it first"),
    ):
        SafetyState(path).__enter__()
    with SafetyState(path):
        pass


def deleted_after_use(path: Path) -> None:
    with SafetyState(path):
        pass
    path.unlink()


def all_deleted_after_a_trip(path: Path) -> None:
    with SafetyState(path) as state:
        state.latch(TripCause.INTERLOCK, "it opened", lit=True)
        state.latch(TripCause.INTERLOCK, "it opened again", lit=False)
    shutil.rmtree(path.parent)


NEW = "new here, or its state was deleted"


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        *[
            (partial(Path.write_text, data=torn), "rig.json")
            for torn in ("", "{", '{"number": 3, "latched": null, "unknown": 1}', '{"number": "x"}')
        ],
        (deleted_after_use, "rig.json is gone"),
        # a new rig, or one whose whole state was deleted: nobody can tell
        (Path.unlink, NEW),
        (all_deleted_after_a_trip, NEW),
    ],
)
def test_what_cannot_be_read_or_is_not_there_counts_as_latched_and_is_acknowledged_once(
    path: Path, spoil: Callable[[Path], object], said: str
) -> None:
    spoil(path)
    seen = SafetyState(path)
    seen.read()
    for trip in (trip_of(path), *([trip_of(seen)] if said != NEW else [])):
        assert (trip.number, trip.cause, trip.lit) == (1, TripCause.POWER, True)
        assert said in trip.why
    assert_acknowledged_once(path)


def test_a_press_is_seen_by_who_only_reads_and_latched_by_who_holds(path: Path) -> None:
    presses = Presses(path.with_suffix(".off"))
    with SafetyState(path) as state:
        assert state.take_press(lit=False) is None
        presses.press("the desk")
        seen = SafetyState(path)
        seen.read()
        taken = state.take_press(lit=True)
        for one in (trip_of(seen), taken):
            assert one is not None
            assert (one.number, one.cause) == (1, TripCause.PERSON)
            assert one.why == "LIGHT OFF was pressed at the desk"
        assert state.take_press(lit=True) is None
        state.acknowledge(1)
        assert state.take_press(lit=True) is None
        assert state.trip is None
        presses.press("the desk")
        presses.press("the desk")
    # pressed while nobody has the rig
    assert_acknowledged_once(path, 2)


def test_a_press_stays_in_the_words_of_the_trip_that_follows(path: Path) -> None:
    Presses(path.with_suffix(".off")).press("the desk")
    with SafetyState(path) as state:
        state.take_press(lit=True)
        state.latch(TripCause.OUTPUT, "it stays lit", lit=True)
        assert trip_of(state).text == "trip 2 (OUTPUT): it stays lit; LIGHT OFF was pressed at the desk"


def test_a_trip_that_comes_while_a_press_is_latched_is_not_lost(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SafetyState(path) as state:
        assert state.presses is not None
        state.presses.press("the desk")
        trip = Thread(target=state.latch, args=(TripCause.OUTPUT, "its spot is seen", True))
        entry = safety_state._LatchEntry

        def meanwhile(**values: Any) -> Any:
            if values["cause"] is TripCause.PERSON:
                trip.start()
                trip.join(0.3)
            return entry(**values)

        monkeypatch.setattr(safety_state, "_LatchEntry", meanwhile)
        state.take_press(lit=True)
        trip.join()
        assert trip_of(state).cause is TripCause.OUTPUT
        assert "its spot is seen; " in trip_of(state).text
        assert "the desk" in trip_of(state).text


def test_a_press_while_a_trip_waits_needs_no_second_acknowledgement(path: Path) -> None:
    presses = Presses(path.with_suffix(".off"))
    with SafetyState(path) as state:
        state.latch(TripCause.INTERLOCK, "it opened", lit=True)
        presses.press("the desk")
        taken = state.take_press(lit=False)
        assert taken is not None
        assert taken.why == "it opened"
        assert state.take_press(lit=False) is None
        state.acknowledge(1)
        assert state.take_press(lit=False) is None


def test_presses_that_are_gone_or_cannot_be_read_count_as_pressed(path: Path) -> None:
    presses = Presses(path.with_suffix(".off"))
    presses.press("the desk")
    with SafetyState(path) as state:
        state.acknowledge(1)
        presses.path.unlink()
        taken = state.take_press(lit=False)
        assert taken is not None
        assert "is gone, so whether LIGHT OFF was pressed is unknown" in taken.why
        state.acknowledge(2)
        assert state.take_press(lit=False) is None
        presses.path.symlink_to(path)
        for number in (3, 4):
            # for as long as it is so
            taken = state.take_press(lit=False)
            assert taken is not None
            assert "cannot be read" in taken.why
            assert state.take_press(lit=False) is None
            state.acknowledge(number)
        presses.path.unlink()


@pytest.fixture
def full(path: Path) -> Iterator[Path]:
    """The same on a disk of its own that has no room left."""
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(path.parent)]
    mounted = subprocess.run(command, capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip(f"nothing can be mounted here: {mounted.stderr.decode()}")
    path.write_text("{}")
    with SafetyState(path):
        pass
    with (path.parent / "filling").open("wb", buffering=0) as filling, suppress(OSError):
        while True:
            filling.write(bytes(4096))
    yield path
    subprocess.run(["umount", str(path.parent)], check=True)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="mounts a disk")
@pytest.mark.parametrize("by", ["the program", "LIGHT OFF"])
def test_on_a_full_disk_nothing_is_lit_and_no_trip_is_forgotten(full: Path, by: str) -> None:
    with SafetyState(full) as state:
        with pytest.raises(DeviceError, match="the rig's state cannot be written: No space left"):
            state.note_light(True)
        if by == "the program":
            with pytest.raises(DeviceError, match="cannot be written"):
                state.latch(TripCause.OUTPUT, "it stays lit", lit=True)
        else:
            assert state.presses is not None
            state.presses.press("the desk")
            with pytest.raises(DeviceError, match="cannot be written"):
                state.take_press(lit=True)
        assert trip_of(state)
        with pytest.raises(DeviceError, match="cannot be written"):
            state.acknowledge(1)
    for _ in range(2):
        assert (trip_of(full).number, trip_of(full).cause) == (1, TripCause.PERSON)
    (full.parent / "filling").unlink()
    assert_acknowledged_once(full)


def test_what_cannot_be_written_holds_and_is_written_later(path: Path) -> None:
    with SafetyState(path) as state:
        # noted already, and to be noted again all the same
        state.note_light(True)
        path.unlink()
        path.mkdir()
        with pytest.raises(DeviceError, match="the rig's state cannot be written"):
            state.latch(TripCause.OUTPUT, "it stays lit", lit=True)
        assert "cannot be written" in state.problem
        assert trip_of(state)
        with pytest.raises(DeviceError, match="the rig's state cannot be written"):
            state.note_light(True)
        path.rmdir()
        state.retry_write()
        assert state.problem == ""
    assert trip_of(path).why == "it stays lit"


def test_what_is_deleted_under_a_program_is_written_again(path: Path) -> None:
    with SafetyState(path) as state:
        shutil.rmtree(path.parent)
        state.latch(TripCause.INTERLOCK, "it opened", lit=True)
    assert trip_of(path).why == "it opened"


def test_an_acknowledgement_that_cannot_be_kept_is_none(path: Path) -> None:
    with SafetyState(path) as state:
        state.latch(TripCause.INTERLOCK, "it opened", lit=True)
        path.unlink()
        path.mkdir()
        with pytest.raises(DeviceError, match="the rig's state cannot be written"):
            state.acknowledge(1)
        assert trip_of(state)
        for _ in range(2):
            # a second try must not take the first one for done
            with pytest.raises(DeviceError, match="the rig's state cannot be written"):
                state.note_light(True)
        path.rmdir()


def test_a_link_is_not_followed(path: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_text("a file of somebody else")
    path.with_suffix(".lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DeviceError, match="the rig's state cannot be held"):
        SafetyState(path).__enter__()
    assert (tmp_path / "elsewhere").read_text() == "a file of somebody else"


def test_each_rig_has_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "tty").symlink_to("/dev/ttyS0")
    board = ControllerSettings(kind="serial", port="/dev/ttyS1")
    cobolt = LaserSettings(kind="cobolt", port="/dev/ttyS0")
    by_another_name = LaserSettings(kind="cobolt", port=str(tmp_path / "tty"))
    none = ControllerSettings()
    paths = [
        rig_state_path(LaserSettings(kind="controller"), board),
        rig_state_path(cobolt, none),
        rig_state_path(cobolt.model_copy(update={"port": "usbtmc"}), none),
    ]
    assert len(set(paths)) == 3
    assert all(path is not None and path.parent == tmp_path / "optical-pendulum-rig" for path in paths)
    assert rig_state_path(by_another_name, none) == rig_state_path(cobolt, board) == paths[1]
    # nothing real is lit
    assert rig_state_path(LaserSettings(), board) is None
    assert rig_state_path(LaserSettings(kind="controller"), ControllerSettings(kind="simulated")) is None


def test_what_is_written_is_what_is_read(path: Path) -> None:
    with SafetyState(path) as state:
        state.note_light(True)
        state.latch(TripCause.WATCHDOG, "lost", lit=True)
    stored = json.loads(path.read_text())
    assert (stored["schema_number"], stored["number"], stored["lit"]) == (1, 1, True)
    with SafetyState(path) as state:
        assert state.left_lit


def test_a_disk_without_locks_is_not_called_another_program(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_locks(monkeypatch)
    with pytest.raises(DeviceError, match=rf"rig\.lock: cannot be locked: {NO_LOCKS}; .*XDG_STATE_HOME"):
        SafetyState(path).__enter__()


class HangingDisk:
    """Takes what is written only once `answers` is set; `asked` is set while somebody waits for it."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.asked, self.answers = Event(), Event()
        usual = atomic_write.replace

        def replace(path: Path, content: bytes) -> None:
            self.asked.set()
            assert self.answers.wait(60.0)
            usual(path, content)

        patch.setattr(atomic_write, "replace", replace)


def test_a_trip_holds_at_once_while_the_disk_hangs_and_is_written_when_it_answers(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SafetyState(path) as state:
        disk = HangingDisk(monkeypatch)
        noted = run_in_thread(state.note_light, True)
        assert disk.asked.wait(10.0)
        tripped = run_in_thread(state.latch, TripCause.INTERLOCK, "it opened", True)
        with pytest.raises(DeviceError, match="the disk hangs"):
            tripped.result(10.0)
        assert trip_of(state).text == "trip 1 (INTERLOCK): it opened"
        assert "the disk hangs" in state.problem
        disk.answers.set()
        noted.result(10.0)
    assert trip_of(path).why == "it opened"
    with SafetyState(path) as state:
        assert state.left_lit


@pytest.mark.parametrize("waits", [False, True], ids=["while it is written", "while it waits for the disk"])
def test_an_acknowledgement_during_which_another_trip_comes_is_none(
    path: Path, monkeypatch: pytest.MonkeyPatch, waits: bool
) -> None:
    with SafetyState(path) as state:
        state.latch(TripCause.INTERLOCK, "it opened", lit=True)
        disk = HangingDisk(monkeypatch)
        if waits:
            run_in_thread(state.note_light, True)
            assert disk.asked.wait(10.0)
        acknowledged = run_in_thread(state.acknowledge, 1)
        assert disk.asked.wait(10.0)
        with pytest.raises(DeviceError, match="the disk hangs"):
            state.latch(TripCause.OUTPUT, "it stays lit", lit=True)
        disk.answers.set()
        with pytest.raises(DeviceError, match=r"(a trip came:|latched is) trip 2 \(OUTPUT\)"):
            acknowledged.result(10.0)
    assert trip_of(path).text == "trip 2 (OUTPUT): it stays lit"
