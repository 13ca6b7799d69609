"""A run and its view, with the real program.

The same is shown live and afterwards; whatever happens to the view, the run goes on.
"""

import os
import signal
import subprocess
import sys
import urllib.parse
from contextlib import suppress
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from numpy.typing import NDArray

from acquisition.record.reader import RecordReader
from acquisition.record.topics import REFERENCE
from rig.control import run_in_thread
from rig.interruption import LOOPBACK, start_python
from rig.terminal import palette
from rig.view import RunningView, show_record
from tests.rig.command_line import CONFIGS, SMALL, rig, set_words
from tests.rig.view.headless_browser import headless_browser, wait_for_picture
from tests.rig.view.headless_viewer import pixels_of
from tests.rig.view.replay_record import make_record
from tests.rig.view.rrd_contents import column, contents, scalars
from tests.waiting import until

BESIDE_REFERENCE = {
    **SMALL,
    "session.max_duration_s": "12",
    # without a fit of the contact, which takes long for a short run
    "instrument.kind": '"tomlinson"',
    "simulation.sensor.height_px": "720",
    "simulation.reference.x_px": "80",
}
IN_REAL_TIME = {
    "simulation.real_time": "true",
    "simulation.sensor.width_px": "96",
    "simulation.sensor.height_px": "320",
    "simulation.optics.arm_m": "0.5",
    "camera.frame_rate_hz": "50",
    "session.max_duration_s": "3",
    "instrument.kind": '"tomlinson"',
}
posix_only = pytest.mark.skipif(os.name != "posix", reason="stops a process with POSIX signals")
pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run beside a reference spot, and `live.rrd`, which was drawn while it was measured."""
    folder = tmp_path_factory.mktemp("live")
    with patch.object(os, "nice"):
        drawn = run_in_thread(follow, folder / "run-1.mcap", folder / "live.rrd")
        done = rig("run", CONFIGS / "vault.toml", "-o", folder, *set_words(BESIDE_REFERENCE), cwd=folder)
        assert (folder / "run-1.mcap").exists(), done.stderr
        drawn.result(120.0)
    show_record(folder / "run-1.mcap", rrd=folder / "again.rrd")
    return folder


def follow(record: Path, rrd: Path) -> None:
    show_record(record, rrd=rrd, follow=True)


def test_what_is_shown_live_is_what_is_shown_afterwards(live: Path) -> None:
    first, again = contents(live / "live.rrd"), contents(live / "again.rrd")
    assert first.keys() == again.keys()
    differing = {key for key in first if first[key] != again[key]}
    assert differing == {("/__properties", "RecordingInfo:start_time")}
    (last_state,) = column(live / "live.rrd", "/state", "TextDocument:text")[1][-1]
    assert last_state.startswith("**done**: time limit of")


def test_curves_of_the_reference_are_its_positions_in_the_record(live: Path) -> None:
    with RecordReader(live / "run-1.mcap") as reader:
        spots = reader.table(REFERENCE.topic)
    for axis in ("x", "y"):
        times_s, values = scalars(live / "again.rrd", f"/reference/{axis}")
        rows = np.searchsorted(spots["time_ns"], spots["time_ns"][0] + np.rint(1e9 * times_s) - 1_000_000)
        expected = spots[f"{axis}_px"] - spots[f"{axis}_px"][0]
        assert values == pytest.approx(expected[rows], abs=1e-9)
        assert len(values) == pytest.approx(10 * times_s[-1], abs=2)


IMPATIENT = """
from rig.cli import main
from rig.view import running_view
running_view._MAX_SHOW_END_S = 2.0
main()
"""
"""`rig`, which waits for less long for what draws its last."""


@pytest.mark.slow
@posix_only
def test_a_view_that_is_stopped_costs_no_frame(tmp_path: Path) -> None:
    words = set_words(IN_REAL_TIME | {"view.mode": '"web"'})
    run = start_python(
        "-c", IMPATIENT, "run", str(CONFIGS / "demo.toml"), "-o", "out", *words,
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    record = tmp_path / "out" / "run-1.mcap"
    views: list[int] = []
    try:
        until(lambda: record.exists() and record.stat().st_size > 40_000)
        views = children_of(run.pid, "view")
        assert len(views) == 1
        for pid in views:
            os.kill(pid, signal.SIGSTOP)
        run.communicate(timeout=120.0)
    finally:
        run.kill()
        run.communicate()
        left = [pid for pid in views if Path(f"/proc/{pid}").exists()]
    assert left == []
    with RecordReader(record) as reader:
        losses = reader.losses()
        assert reader.is_sound
        assert losses is not None
        assert losses.total == 0
        sequence = reader.spots()["sequence"]
        assert np.array_equal(sequence, np.arange(len(sequence)))
        assert len(sequence) >= 3 * 50


@posix_only
def test_a_view_whose_record_never_comes_ends_with_what_started_it(tmp_path: Path) -> None:
    view = RunningView(tmp_path / "run.mcap", "web", "measuring")
    assert view._process is not None
    view.close()
    with pytest.raises(ProcessLookupError):
        os.kill(view._process.pid, 0)


def test_another_record_after_a_rejected_start_is_drawn_too(tmp_path: Path) -> None:
    record, rrd = tmp_path / "run.mcap", tmp_path / "run.rrd"
    with patch.object(os, "nice"):
        drawn = run_in_thread(follow, record, rrd)
        make_record(record, 20.0, end="rejected")
        until(rrd.exists)
        record.rename(tmp_path / "run-start-1.mcap")
        make_record(tmp_path / "made.mcap", 15.0).rename(record)
        drawn.result(60.0)
    assert len(scalars(rrd, "/deflection/x")[0]) == 749


WANTED = (palette.TRAJECTORY_COLOUR, palette.X_COLOUR, palette.Y_COLOUR, palette.PERIOD_COLOUR)


def drawn(picture: NDArray[np.uint8]) -> bool:
    return all(pixels_of(picture, colour) > 60 for colour in WANTED)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads the sockets from /proc/net/tcp")
def test_a_page_shows_a_record_to_this_machine_only_and_asks_no_other(tmp_path: Path) -> None:
    record = make_record(tmp_path / "run.mcap", 60.0)
    with (
        headless_browser(webgl=True) as browser,
        subprocess.Popen(
            [sys.executable, "-m", "rig", "view", record, "--view", "web"],
            stdout=subprocess.PIPE, text=True, start_new_session=True,
        ) as view,
    ):  # fmt: skip
        try:
            assert view.stdout is not None
            address = view.stdout.readline().split()[4]
            assert address.startswith(f"http://{LOOPBACK}:")
            browser.open(address)
            picture = wait_for_picture(browser, drawn, 120.0, tmp_path / "page.png")
            for colour in WANTED:
                assert pixels_of(picture, colour) > 60, f"nothing drawn in {colour}"
            asked = {urllib.parse.urlsplit(address).hostname for address in browser.requested}
            assert asked <= {LOOPBACK, None}, asked
            (program,) = children_of(view.pid, "serve-web")
            until(lambda: len(listening(program)) >= 2)
            assert {place.split(":")[0] for place in listening(program)} == {"0100007F"}
        finally:
            view.send_signal(signal.SIGINT)
            view.wait(60.0)
    assert not Path(f"/proc/{program}").exists()


def children_of(parent: int, word: str) -> list[int]:
    """Processes of a parent whose command has this word."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            state = (place / "stat").read_text().rpartition(")")[2].split()
            if int(state[1]) == parent and word in (place / "cmdline").read_text().replace("\0", " "):
                found.append(int(place.name))
    return found


def listening(pid: int) -> set[str]:
    """Local addresses (hexadecimal, as in /proc/net/tcp) on which a process listens."""
    handles = []
    for handle in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(OSError):
            handles.append(os.readlink(handle))
    tables = [Path(file).read_text().splitlines()[1:] for file in ("/proc/net/tcp", "/proc/net/tcp6")]
    rows = [line.split() for table in tables for line in table]
    return {fields[1] for fields in rows if fields[3] == "0A" and f"socket:[{fields[9]}]" in handles}
