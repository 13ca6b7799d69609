"""The viewer's process: content of the file, and faults that must not affect the session."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from processing.errors import ConfigurationError, RecordError
from rig.rerun import Trouble
from rig.rerun.ports import free_port
from rig.view.viewer import Viewer
from tests.rig.view import scene as view_scene
from tests.rig.view.rrd_contents import column, measured, scalars

posix_only = pytest.mark.skipif(os.name != "posix", reason="stops a process with POSIX signals")
# No call may wait for the worker. A bound far above what a busy machine needs, far below any wait.
CALL_LIMIT_S = 0.5


def wait_until(what: Callable[[], bool], limit_s: float = 40.0) -> None:
    deadline = time.monotonic() + limit_s
    while not what():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.05)


def timed(call: Callable[[], None]) -> float:
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def send_second(viewer: Viewer, start_s: float) -> float:
    """A second of samples, ten calls, at ten times real speed; the longest call in seconds."""
    longest = 0.0
    for block in range(10):
        time_s = start_s + block * 0.1 + np.arange(500) / 5000
        flags = np.zeros(500, dtype=np.int64)
        longest = max(longest, timed(lambda t=time_s, f=flags: viewer.samples(t, np.sin(t), np.cos(t), f)))
        time.sleep(0.01)
    return longest


@pytest.mark.slow
def test_everything_arrives_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    viewer = Viewer(path)
    viewer.start()
    count = view_scene.play(viewer)
    counts = viewer.close()
    assert counts.dropped == 0, counts
    assert counts.restarts == 0
    assert counts.sent > count
    random = np.random.default_rng(1)
    expected = view_scene.trajectory(next(view_scene.blocks(1.0)), random)[0]
    times_s, x = scalars(path, "/deflection/x")
    assert len(times_s) == count
    np.testing.assert_allclose(times_s[:10], np.arange(10) / 100, atol=1e-9)
    np.testing.assert_array_equal(x[: len(expected)], expected)
    assert len(measured(path, "/amplitude")[0]) == 30


def test_the_trajectory_in_the_file_has_y_upward(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    with Viewer(path) as viewer:
        time_s = np.arange(100) / 100
        viewer.samples(time_s, 3 * time_s, 7 * time_s, np.zeros(100, dtype=np.int64))
    _, strips = column(path, "/lissajous/equal/trajectory/recent", "LineStrips2D:strips")
    np.testing.assert_allclose(strips[-1][0][-1], [3 * 0.99, -7 * 0.99], rtol=1e-6)


@pytest.mark.slow
def test_a_healthy_worker_drops_nothing_in_real_time(tmp_path: Path) -> None:
    # 5,000 samples and 10 images of 1280 x 1024 a second.
    image = np.random.default_rng(0).integers(0, 255, (1024, 1280), dtype=np.uint8)
    image.flags.writeable = False
    with Viewer(tmp_path / "run.rrd", queue_bytes=4 << 20) as viewer:
        wait_until(lambda: viewer.counts.alive)
        for block in range(20):
            time_s = block * 0.1 + np.arange(500) / 5000
            viewer.samples(time_s, np.sin(time_s), np.cos(time_s), np.zeros(500, dtype=np.int64))
            viewer.image(float(time_s[-1]), image, (600.0, 500.0))
            time.sleep(0.1)
    assert viewer.counts.dropped == 0
    assert viewer.counts.sent == 20 * 501


@pytest.mark.slow
def test_a_whole_run_faster_than_real_time_goes_through(tmp_path: Path) -> None:
    # The demo: 118,000 samples in blocks of 64, as fast as they can be handed over.
    path = tmp_path / "run.rrd"
    with Viewer(path, amplitude=124.0) as viewer:
        for first in range(0, 118_000, 64):
            time_s = np.arange(first, first + 64) / 100
            x, y = view_scene.trajectory(time_s, np.random.default_rng(first))
            viewer.samples(time_s, x, y, np.zeros(64, dtype=np.int64))
    assert viewer.counts.dropped == 0
    assert len(scalars(path, "/deflection/y")[0]) == 118_016
    # Twenty minutes take less than 20 MB: what is drawn is bounded, whatever the frame rate.
    assert path.stat().st_size < 20e6


@pytest.mark.slow
@posix_only
def test_a_killed_worker_is_replaced_and_goes_on_in_a_second_file(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    viewer = Viewer(path)
    viewer.start()
    wait_until(lambda: viewer.counts.alive)
    send_second(viewer, 0.0)
    wait_until(lambda: viewer.counts.sent >= 5000)
    pid = viewer.worker_pids[0]
    os.kill(pid, signal.SIGKILL)
    longest = max(send_second(viewer, float(second)) for second in range(1, 5))
    assert longest < CALL_LIMIT_S
    wait_until(lambda: viewer.counts.alive and viewer.counts.restarts == 1)
    counts = viewer.close()
    assert counts.sent + counts.dropped == 25_000
    assert counts.sent >= 15_000
    times_s, _ = scalars(tmp_path / "run-part2.rrd", "/deflection/x")
    assert times_s[-1] == pytest.approx(4.99, abs=0.011)


@pytest.mark.slow
@posix_only
def test_a_stopped_worker_costs_nothing_but_what_it_held(tmp_path: Path) -> None:
    viewer = Viewer(tmp_path / "run.rrd", hang_limit_s=1.0)
    viewer.start()
    wait_until(lambda: viewer.counts.alive)
    stopped = viewer.worker_pids[0]
    os.kill(stopped, signal.SIGSTOP)
    longest = max(send_second(viewer, float(second)) for second in range(10))
    assert longest < CALL_LIMIT_S
    wait_until(lambda: viewer.counts.restarts == 1 and viewer.counts.alive)
    counts = viewer.close()
    assert 0 < counts.dropped < 50_000
    assert counts.sent + counts.dropped == 50_000
    with pytest.raises(ProcessLookupError):
        os.kill(stopped, 0)


@posix_only
def test_close_ends_in_time_with_a_stopped_worker(tmp_path: Path) -> None:
    viewer = Viewer(tmp_path / "run.rrd", hang_limit_s=60.0)
    viewer.start()
    wait_until(lambda: viewer.counts.alive)
    pid = viewer.worker_pids[0]
    os.kill(pid, signal.SIGSTOP)
    send_second(viewer, 0.0)
    assert timed(lambda: viewer.close(timeout_s=1.0)) < 10.0
    assert viewer.counts.dropped == 5000
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@posix_only
def test_a_full_queue_drops_the_oldest(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    viewer = Viewer(path, queue_bytes=200_000, hang_limit_s=60.0)
    viewer.start()
    wait_until(lambda: viewer.counts.alive)
    os.kill(viewer.worker_pids[0], signal.SIGSTOP)
    for second in range(20):
        send_second(viewer, float(second))
    os.kill(viewer.worker_pids[0], signal.SIGCONT)
    counts = viewer.close()
    assert counts.dropped > 0
    assert counts.sent + counts.dropped == 100_000
    times_s, _ = scalars(path, "/deflection/x")
    assert times_s[-1] > 19.9


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here to stand for a full disk")
def test_a_full_disk_is_told_and_stops_nothing(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    path.symlink_to("/dev/full")
    viewer = Viewer(path)
    viewer.start()
    wait_until(lambda: viewer.counts.alive)
    longest = max(send_second(viewer, float(second)) for second in range(5))
    time.sleep(2.5)
    longest = max(longest, send_second(viewer, 5.0))
    wait_until(lambda: bool(viewer.counts.notes))
    longest = max(longest, send_second(viewer, 6.0))
    counts = viewer.close()
    assert longest < CALL_LIMIT_S
    assert "No space left" in counts.notes[0]
    assert str(path) in counts.notes[0]
    assert counts.troubles == {Trouble.FILE_ENDED}
    assert counts.dropped > 0
    assert counts.sent + counts.dropped == 35_000
    with pytest.raises(RecordError, match=r"run\.rrd is not whole: \d+ values are not in it"):
        viewer.check_file()


@pytest.mark.parametrize("words", ["in other words", "view: a Curve could not be drawn"])
def test_a_file_lacks_what_a_worker_could_not_draw_whatever_it_says(tmp_path: Path, words: str) -> None:
    path = tmp_path / "run.rrd"
    viewer = Viewer(path)
    path.write_bytes(b"a run")
    viewer._note(f"a port is in use; {words}")
    viewer.check_file()
    viewer._note(words, Trouble.NOT_DRAWN)
    with pytest.raises(RecordError, match=words):
        viewer.check_file()


def test_a_folder_that_is_missing_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"missing/run\.rrd"):
        Viewer(tmp_path / "missing" / "run.rrd")


def test_an_existing_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    path.write_bytes(b"a run")
    with pytest.raises(ConfigurationError, match="exists already"):
        Viewer(path)
    assert path.read_bytes() == b"a run"


def test_without_a_screen_the_reason_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    if not sys.platform.startswith("linux"):
        pytest.skip("a screen may be missing on Linux only")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with Viewer(None, "spawn", port=free_port(0)) as viewer:
        wait_until(lambda: bool(viewer.counts.notes))
    assert "no screen" in viewer.counts.notes[0]


def test_a_port_that_is_taken_is_avoided_and_told() -> None:
    with socket.socket() as holder:
        # at every address: the stream's is one of the loopback's that cannot be guessed
        holder.bind(("", 0))
        holder.listen()
        taken = holder.getsockname()[1]
        with Viewer(None, "spawn", port=taken) as viewer:
            wait_until(lambda: viewer.counts.alive)
            send_second(viewer, 0.0)
            wait_until(lambda: viewer.counts.sent == 5000)
    assert str(taken) in viewer.counts.notes[0]
    assert str(taken) not in viewer.counts.url


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads the sockets from /proc/net/tcp")
def test_the_live_view_listens_on_this_machine_only() -> None:
    with Viewer(None, "web", port=free_port(0), web_port=free_port(0)) as viewer:
        wait_until(lambda: viewer.counts.alive and bool(viewer.counts.notes))
        pids = [*viewer.worker_pids, *viewer.program_pids]
        assert len(pids) == 2
        wait_until(lambda: all(listening(pid) for pid in pids))
        addresses = {address for pid in pids for address in listening(pid)}
    # 127.*.*.* as the kernel writes it, and no socket of IPv6; only the page's address is known
    hosts = {address.split(":")[0] for address in addresses}
    assert all(len(host) == 8 and host.endswith("7F") for host in hosts)
    assert "0100007F" in hosts
    if sys.platform.startswith("linux"):
        assert len(hosts) == 2
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


@pytest.mark.slow
@posix_only
def test_the_worker_ends_with_a_session_that_was_killed(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    session = subprocess.Popen(
        [sys.executable, "-c", SESSION, str(path)], stdout=subprocess.PIPE, text=True, cwd=Path.cwd()
    )
    assert session.stdout is not None
    pid = int(session.stdout.readline())
    session.kill()
    session.wait()
    session.stdout.close()

    def gone() -> bool:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        return "Z" in Path(f"/proc/{pid}/stat").read_text().split()[2] if Path("/proc").exists() else False

    wait_until(gone)
    assert len(scalars(path, "/deflection/x")[0]) == 100


SESSION = """
import sys, time
from pathlib import Path
import numpy as np
from rig.view.viewer import Viewer
viewer = Viewer(Path(sys.argv[1]))
viewer.start()
time_s = np.arange(5000) / 5000
viewer.samples(time_s, time_s, time_s, np.zeros(5000, dtype=int))
while viewer.counts.sent < 5000:
    time.sleep(0.05)
print(viewer.worker_pids[0], flush=True)
time.sleep(60)
"""


def test_nothing_is_started_where_nothing_is_wanted() -> None:
    with Viewer(None) as viewer:
        view_scene.play(viewer, seconds=1.0)
    counts = viewer.counts
    assert (counts.sent, counts.dropped, counts.alive) == (0, 0, False)
    assert viewer.worker_pids == ()


def test_arrays_are_copied(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    with Viewer(path) as viewer:
        time_s = np.arange(10) / 100
        x = np.ones(10)
        viewer.samples(time_s, x, x, np.zeros(10, dtype=np.int64))
        x[:] = 5.0
        time_s[:] = 9.0
    times_s, read = scalars(path, "/deflection/x")
    assert times_s[-1] == pytest.approx(0.09)
    assert (read == 1.0).all()


def listening(pid: int) -> set[str]:
    """Local addresses (hexadecimal, as in /proc/net/tcp) on which a process listens."""
    sockets = set()
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
