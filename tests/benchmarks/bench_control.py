"""Response time of the controller; a controller that does not answer costs no frame.

The firmware runs on node's MicroPython behind a pseudo-terminal, as in the tests.
"""

import json
import os
import pty
import queue
import shutil
import subprocess
import tempfile
import threading
import time
import tty
from pathlib import Path
from typing import Any

import numpy as np

from rig.control.controller import Controller
from rig.control.service import ControlService
from rig.control.settings import ControllerSettings
from rig.control.simulated import simulated_controller
from tests.rig.control.conftest import PACKAGE, VERSION
from tests.rig.control.wires import FirmwareBoard

FRAME_RATE_HZ = 500.0
# Half a second: a busy operating system alone can hold a thread up for 0.2 s.
QUEUE_FRAMES = 256


def run(quick: bool = False) -> dict[str, Any]:
    """Measure; the numbers are also printed."""
    seconds = 3.0 if quick else 20.0
    results: dict[str, Any] = {"simulated": _simulated(1000 if quick else 5000)}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        package = _interpreter(folder)
        if package is None:
            results["skipped"] = "node and npm are needed to run the firmware"
        else:
            board = FirmwareBoard(package, folder)
            try:
                results["pty"] = _speed(board.port, 2000 if quick else 10000)
                results["reconnects"] = _descriptors(board.port, 30 if quick else 300)
            finally:
                board.close()
    rounds = 2 if quick else 3
    alone, stuck = [], []
    for _ in range(rounds):
        alone.append(_frames(seconds / 2, None))
        stuck.append(_frames(seconds / 2, _stuck_service()))
    results["frames_alone"] = _sum(alone)
    results["frames_with_stuck_line"] = _sum(stuck)
    print(json.dumps(results, indent=2))
    return results


def _settings(port: str) -> ControllerSettings:
    return ControllerSettings(kind="serial", port=port, timeout_s=0.5)


def _speed(port: str, count: int) -> dict[str, float]:
    settings = _settings(port)
    controller = Controller(settings, 0.001)
    controller.open()
    took_s = []
    for _ in range(count):
        start = time.perf_counter()
        controller.heartbeat()
        took_s.append(time.perf_counter() - start)
    retried = controller.line_counts()[2]
    controller.close()
    with ControlService(controller, settings) as service:
        service.wait_open()
        start = time.perf_counter()
        futures = [service.submit(Controller.interlock_closed, 60.0) for _ in range(count)]
        for future in futures:
            future.result(60.0)
        queued_s = time.perf_counter() - start
    times_ms = np.array(took_s) * 1e3
    return {
        "commands_per_s": count / float(np.sum(took_s)),
        "commands_per_s_through_service": count / queued_s,
        "median_ms": float(np.median(times_ms)),
        "p99_ms": float(np.percentile(times_ms, 99)),
        "max_ms": float(times_ms.max()),
        "asked_again": retried,
    }


def _simulated(count: int) -> dict[str, float]:
    settings = ControllerSettings(kind="simulated")
    controller = simulated_controller(settings, 0.001)
    controller.open()
    start = time.perf_counter()
    for _ in range(count):
        controller.heartbeat()
    took_s = time.perf_counter() - start
    controller.close()
    return {"commands_per_s": count / took_s}


def _descriptors(port: str, cycles: int) -> dict[str, int]:
    settings = _settings(port)
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(cycles):
        with ControlService(Controller(settings, 0.001), settings) as service:
            service.wait_open()
    return {"cycles": cycles, "descriptors_left": len(os.listdir("/proc/self/fd")) - before}


def _stuck_service() -> ControlService:
    """A service whose line takes everything and never answers: it sits in its timeout all the time."""
    _, slave = pty.openpty()
    tty.setraw(slave)
    settings = ControllerSettings(kind="serial", port=os.ttyname(slave), timeout_s=1.0, retries=2)
    return ControlService(Controller(settings, 0.001), settings)


def _frames(seconds: float, service: ControlService | None) -> dict[str, float]:
    """A camera's thread at 500 frames/s hands over to a thread that also looks at the controller's state."""
    frames: queue.Queue[np.ndarray | None] = queue.Queue(maxsize=QUEUE_FRAMES)
    image = np.zeros((640, 320), np.uint8)
    lost = processed = 0
    late_s: list[float] = []
    longest_call_s = 0.0

    def process() -> None:
        nonlocal processed, longest_call_s
        while (frame := frames.get()) is not None:
            int(frame[:64, :64].sum())
            if service is not None:
                before = time.perf_counter()
                _ = service.snapshot.state
                if processed % 50 == 0:
                    service.laser_off()
                longest_call_s = max(longest_call_s, time.perf_counter() - before)
            processed += 1

    if service is not None:
        service.start()
        time.sleep(0.2)
    worker = threading.Thread(target=process)
    worker.start()
    period_s = 1.0 / FRAME_RATE_HZ
    start = time.perf_counter()
    total = int(seconds * FRAME_RATE_HZ)
    for index in range(total):
        due = start + index * period_s
        while (wait := due - time.perf_counter()) > 0:
            time.sleep(wait)
        late_s.append(time.perf_counter() - due)
        try:
            frames.put_nowait(image)
        except queue.Full:
            lost += 1
    frames.put(None)
    worker.join()
    cpu_s = _cpu_of("rig-control")
    if service is not None:
        service.close()
    late_ms = np.array(late_s) * 1e3
    return {
        "frames": total,
        "lost": lost,
        "processed": processed,
        "control_cpu_ms": cpu_s * 1e3,
        "longest_call_ms": longest_call_s * 1e3,
        "late_p99_ms": float(np.percentile(late_ms, 99)),
        "late_max_ms": float(late_ms.max()),
    }


def _cpu_of(name: str) -> float:
    """Processor time of a thread so far: what it could have taken from the others at most."""
    for thread in threading.enumerate():
        if thread.name == name and thread.ident is not None:
            return time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
    return 0.0


def _sum(parts: list[dict[str, float]]) -> dict[str, float]:
    return {
        key: (max if key.startswith(("late", "longest")) else sum)(part[key] for part in parts)
        for key in parts[0]
    }


def _interpreter(folder: Path) -> Path | None:
    if shutil.which("node") is None or shutil.which("npm") is None:
        return None
    done = subprocess.run(
        ["npm", "install", "--no-audit", "--no-fund", "--prefix", str(folder), f"{PACKAGE}@{VERSION}"],
        capture_output=True,
        timeout=120,
        check=False,
    )
    return folder / "node_modules" / PACKAGE if done.returncode == 0 else None


if __name__ == "__main__":
    run()
