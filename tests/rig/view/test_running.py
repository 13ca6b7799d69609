"""A run and its view, with the real program.

The same is shown live and afterwards; whatever happens to the view, the run goes on.
"""

import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from acquisition.record.topics import REFERENCE
from rig.interruption import LOOPBACK, start_python
from rig.view import RunningView, show_record
from tests.rig.command_line import CONFIGS, SMALL, rig, set_words
from tests.rig.view.replay_record import make_record
from tests.rig.view.rrd_contents import column, contents, entities, scalars
from tests.waiting import until

SHORT = {
    **SMALL,
    "session.max_duration_s": "20",
    "instrument.kind": '"tomlinson"',
}
"""Without a fit of the contact, which takes long for a short run."""
IN_REAL_TIME = {
    "simulation.real_time": "true",
    "simulation.sensor.width_px": "96",
    "simulation.sensor.height_px": "320",
    "simulation.optics.arm_m": "0.5",
    "camera.frame_rate_hz": "50",
    "session.max_duration_s": "6",
    "instrument.kind": '"tomlinson"',
}
posix_only = pytest.mark.skipif(os.name != "posix", reason="stops a process with POSIX signals")
pytestmark = pytest.mark.timeout(300)


def drawn_live(folder: Path, config: str, settings: dict[str, str]) -> Path:
    """A folder with a run, and `live.rrd`, which was drawn while it was measured."""
    record = folder / "run-1.mcap"
    view = start_python("-m", "rig", "view", str(record), "--follow", "--rrd", str(folder / "live.rrd"))
    done = rig("run", CONFIGS / config, "-o", folder, *set_words(settings), cwd=folder)
    assert record.exists(), done.stderr
    assert view.wait(120.0) == 0
    return folder


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drawn_live(tmp_path_factory.mktemp("live"), "demo.toml", SHORT)


def test_what_is_shown_live_is_what_is_shown_afterwards(live: Path, tmp_path: Path) -> None:
    show_record(live / "run-1.mcap", rrd=tmp_path / "again.rrd")
    first, again = contents(live / "live.rrd"), contents(tmp_path / "again.rrd")
    assert first.keys() == again.keys()
    differing = {key for key in first if first[key] != again[key]}
    assert differing == {("/__properties", "RecordingInfo:start_time")}
    (last_state,) = column(live / "live.rrd", "/state", "TextDocument:text")[1][-1]
    assert last_state.startswith("**done**: time limit of")
    # a rig without a reference spot has no such curve
    assert not [path for path in entities(live / "live.rrd") if "reference" in path]


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
        until(lambda: record.exists() and record.stat().st_size > 100_000)
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
        assert len(sequence) >= 6 * 50


@posix_only
def test_a_view_whose_record_never_comes_ends_with_what_started_it(tmp_path: Path) -> None:
    view = RunningView(tmp_path / "run.mcap", "web", "measuring")
    assert view._process is not None
    view.close()
    with pytest.raises(ProcessLookupError):
        os.kill(view._process.pid, 0)


def test_another_record_after_a_rejected_start_is_drawn_too(tmp_path: Path) -> None:
    record, rrd = tmp_path / "run.mcap", tmp_path / "run.rrd"
    view = start_python("-m", "rig", "view", str(record), "--follow", "--rrd", str(rrd))
    make_record(record, 20.0, end="rejected")
    until(rrd.exists)
    record.rename(tmp_path / "run-start-1.mcap")
    make_record(tmp_path / "made.mcap", 15.0).rename(record)
    assert view.wait(60.0) == 0
    assert len(scalars(rrd, "/deflection/x")[0]) == 749


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads the sockets from /proc/net/tcp")
def test_the_page_is_served_to_this_machine_only(live: Path) -> None:
    """It is looked at in a browser in test_web.py."""
    shown = subprocess.Popen(
        [sys.executable, "-m", "rig", "view", live / "run-1.mcap", "--view", "web"],
        stdout=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        assert shown.stdout is not None
        address = shown.stdout.readline().split()[4]
        (program,) = children_of(shown.pid, "serve-web")
        until(lambda: len(listening(program)) >= 2)
        assert {place.split(":")[0] for place in listening(program)} == {"0100007F"}
        assert address.startswith(f"http://{LOOPBACK}:")
        with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(address, timeout=30) as page:
            assert page.status == 200
    finally:
        shown.send_signal(signal.SIGINT)
        shown.communicate(timeout=60.0)
    assert not Path(f"/proc/{program}").exists()


def processes() -> Iterator[tuple[int, int, str]]:
    """Number, parent and command of all processes."""
    for place in Path("/proc").glob("[0-9]*"):
        try:
            state = (place / "stat").read_text().rpartition(")")[2].split()
            yield int(place.name), int(state[1]), (place / "cmdline").read_text().replace("\0", " ")
        except OSError:
            continue


def children_of(parent: int, word: str) -> list[int]:
    return [pid for pid, of, command in processes() if of == parent and word in command]


def listening(pid: int) -> set[str]:
    """Local addresses (hexadecimal, as in /proc/net/tcp) on which a process listens."""
    sockets: set[Any] = set()
    for handle in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = os.readlink(handle)
        except OSError:
            continue
        if target.startswith("socket:["):
            sockets.add(target[8:-1])
    found = set()
    for file in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(file).read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in sockets:
                found.add(fields[1])
    return found


BESIDE_REFERENCE = SHORT | {
    "session.max_duration_s": "12",
    "simulation.sensor.height_px": "720",
    "simulation.reference.x_px": "80",
}


@pytest.fixture(scope="module")
def vault(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drawn_live(tmp_path_factory.mktemp("vault"), "vault.toml", BESIDE_REFERENCE)


def test_live_and_recorded_curves_are_the_positions_of_the_record(vault: Path, tmp_path: Path) -> None:
    show_record(vault / "run-1.mcap", rrd=tmp_path / "again.rrd")
    with RecordReader(vault / "run-1.mcap") as reader:
        spots = reader.table(REFERENCE.topic)
    for axis in ("x", "y"):
        times_s, values = scalars(tmp_path / "again.rrd", f"/reference/{axis}")
        rows = np.searchsorted(spots["time_ns"], spots["time_ns"][0] + np.rint(1e9 * times_s) - 1_000_000)
        expected = spots[f"{axis}_px"] - spots[f"{axis}_px"][0]
        assert values == pytest.approx(expected[rows], abs=1e-9)
        assert len(values) == pytest.approx(10 * times_s[-1], abs=2)
        live = scalars(vault / "live.rrd", f"/reference/{axis}")
        assert np.array_equal(live[1], values)
        assert live[0] == pytest.approx(times_s)
