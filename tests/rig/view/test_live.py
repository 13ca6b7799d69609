"""A viewer connected to a live run is stopped, its worker killed, and it then shows the run again."""

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from rerun.experimental import ViewerClient

from rig.rerun.ports import free_port
from rig.rerun.rerun_program import start_program
from rig.view import viewer_program as viewer_module
from rig.view.viewer import Viewer
from tests.rig.view.headless_viewer import connected, headless_environment, require_software_vulkan
from tests.rig.view.rrd_contents import scalars

pytestmark = [pytest.mark.slow, pytest.mark.realtime]

CALL_LIMIT_S = 0.5
RATE_HZ = 5000
IMAGE = np.random.default_rng(0).integers(0, 255, (1024, 1280), dtype=np.uint8)
IMAGE.flags.writeable = False


class Windows:
    """Stands for `open_window` where there is no screen: the same program, without one."""

    def __init__(self, runtime: str) -> None:
        self._runtime = runtime
        self.opened: list[tuple[subprocess.Popen[bytes], int]] = []

    def __call__(self, url: str, port: int) -> subprocess.Popen[bytes]:
        program = start_program(
            *("--headless", "--port", str(port), "--hide-welcome-screen", "--connect", url),
            environment=headless_environment(self._runtime),
        )
        self.opened.append((program, port))
        return program

    def client(self) -> ViewerClient:
        return connected(self.opened[0][1], time.monotonic() + 40.0)


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> Iterator[Windows]:
    require_software_vulkan()
    with tempfile.TemporaryDirectory() as runtime:
        opened = Windows(runtime)
        monkeypatch.setattr(viewer_module, "display_missing", lambda: "")
        monkeypatch.setattr(viewer_module, "open_window", opened)
        yield opened
        for program, _ in opened.opened:
            program.kill()
            program.wait()


def test_a_stopped_window_and_a_killed_worker_cost_neither_time_nor_file(
    windows: Windows, tmp_path: Path
) -> None:
    rrd = tmp_path / "run.rrd"
    viewer = Viewer(rrd, "spawn", port=free_port(0), hang_limit_s=2.0)
    viewer.start()
    wait_until(lambda: viewer.counts.alive and bool(windows.opened))
    client = windows.client()
    window = windows.opened[0][0]
    longest = run(viewer, 0.0, 2.0)
    wait_until(lambda: shown_s(client) > 1.5)

    window.send_signal(signal.SIGSTOP)
    longest = max(longest, run(viewer, 2.0, 6.0))
    window.send_signal(signal.SIGCONT)
    longest = max(longest, run(viewer, 8.0, 2.0))
    wait_until(lambda: shown_s(client) > 8.0)

    live_pid = viewer.worker_pids[1]
    os.kill(live_pid, signal.SIGKILL)
    longest = max(longest, run(viewer, 10.0, 4.0))
    wait_until(lambda: shown_s(client) > 13.0)
    restarts = viewer.counts.restarts
    viewer.close()

    assert longest < CALL_LIMIT_S
    assert restarts >= 1
    assert len(windows.opened) == 1
    # The file's worker had nothing to do with all this: the file is whole, in one part.
    times_s, _ = scalars(rrd, "/deflection/x")
    np.testing.assert_allclose(times_s, np.arange(1400) / 100, atol=1e-3)
    assert not list(tmp_path.glob("*part*"))


def test_several_windows_of_time_fit_into_the_servers_memory(windows: Windows) -> None:
    # Nobody is connected, images flow: the live worker's memory stays bounded, nothing waits.
    viewer = Viewer(None, "web", port=free_port(0), web_port=free_port(0), memory_limit="20MiB")
    viewer.start()
    wait_until(lambda: viewer.counts.alive)
    longest = run(viewer, 0.0, 3.0, every_s=0.03)
    resident = memory_bytes(viewer.worker_pids[0])
    longest = max(longest, run(viewer, 3.0, 12.0, every_s=0.03))
    grown = memory_bytes(viewer.worker_pids[0]) - resident
    counts = viewer.close()
    assert longest < CALL_LIMIT_S
    assert counts.restarts == 0
    assert grown < 150e6


def run(viewer: Viewer, start_s: float, seconds: float, every_s: float = 0.1) -> float:
    """5,000 samples and 10 images a second of the run, whose tenths last `every_s`; the longest call in s."""
    longest = 0.0
    for block in range(round(seconds * 10)):
        time_s = start_s + block * 0.1 + np.arange(RATE_HZ // 10) / RATE_HZ
        begin = time.perf_counter()
        viewer.samples(time_s, np.sin(time_s), np.cos(time_s), np.zeros(len(time_s), dtype=np.int64))
        viewer.image(float(time_s[-1]), IMAGE, (600.0, 500.0))
        longest = max(longest, time.perf_counter() - begin)
        time.sleep(every_s)
    return longest


def shown_s(client: ViewerClient) -> float:
    """Where the viewer's time cursor is, which follows the run."""
    try:
        recordings = client.get_state().recordings
    except (RuntimeError, OSError):
        return -1.0
    times = [recording.current_time for recording in recordings if recording.current_time is not None]
    return max(times, default=-1_000_000_000) * 1e-9


def memory_bytes(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith("VmRSS"))
    return float(line.split()[1]) * 1024


def wait_until(what: Callable[[], bool], limit_s: float = 40.0) -> None:
    deadline = time.monotonic() + limit_s
    while not what():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.2)
