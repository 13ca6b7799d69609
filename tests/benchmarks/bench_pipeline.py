"""Camera to record, in real time from memory: drops, latency, processor time; and the demo as a whole.

Run as ``python -m tests.benchmarks pipeline [--quick]`` from the repository.
"""

import json
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from acquisition.camera import CameraInfo, CameraSettings, CameraStatus
from acquisition.frame import Frame
from acquisition.simulation.settings import OpticsTruth, SensorTruth, SimulationSettings
from calibration.axes import Axes
from calibration.light_lever import Lever
from processing.spot import SensorModel
from rig.devices.frame_stream import FrameStream
from rig.devices.session_devices import OpenCamera
from rig.instrument.kernels import prepare_kernels
from rig.instrument.pipeline import Optics
from rig.instrument.snapshot import Snapshot
from rig.measure.end_of_run import EndLimits
from rig.measure.record_file import RecordFile
from rig.measure.recorder import Entry, Recorder
from rig.measure.run import Run
from rig.measure.run_parts import RunParts, Watcher
from rig.settings import validate_configuration

ROOT = Path(__file__).resolve().parents[2]


class MemoryCamera:
    """Frames that were drawn beforehand, handed out at a fixed rate by the host's clock."""

    def __init__(
        self, frames: list[np.ndarray[Any, Any]], full_scale_dn: int, rate_hz: float, duration_s: float
    ) -> None:
        self._frames = frames
        self._full_scale_dn = full_scale_dn
        self._period_ns = round(1e9 / rate_hz)
        self._count = round(duration_s * rate_hz)
        self._next = 0
        self._start_ns = 0
        self._stopped = threading.Event()

    def open(self) -> CameraInfo:
        ny, nx = self._frames[0].shape
        return CameraInfo("memory", "", "", "", nx, ny, self._full_scale_dn, True)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def start(self) -> None:
        self._start_ns = time.monotonic_ns()
        self._next = 0

    def read(self, timeout_s: float) -> Frame | None:
        if self._next >= self._count or self._stopped.is_set():
            return None
        due_ns = self._start_ns + self._next * self._period_ns
        wait_ns = due_ns - time.monotonic_ns()
        if wait_ns > 0:
            time.sleep(wait_ns * 1e-9)
        # there and back through the drawn swing, so that the spot never jumps
        turn = 2 * len(self._frames) - 2
        place = self._next % turn
        image = self._frames[place if place < len(self._frames) else turn - place]
        frame = Frame(image, self._next, due_ns, max(due_ns, time.monotonic_ns()))
        self._next += 1
        return frame

    def stop(self) -> None:
        self._stopped.set()

    def close(self) -> None:
        self._stopped.set()

    @property
    def status(self) -> CameraStatus:
        return CameraStatus(delivered=self._next)


def drawn_frames(
    width: int, height: int, bits: Literal[8, 12], rate_hz: float, count: int
) -> list[np.ndarray[Any, Any]]:
    """Half a swing across the sensor, drawn by the simulated rig."""
    settings = SimulationSettings(
        sensor=SensorTruth(width_px=width, height_px=height, bit_depth=bits),
        optics=OpticsTruth(arm_m=1.0 * height / 640),
    )
    settings = settings.model_copy(
        update={"clock": settings.clock.model_copy(update={"frame_rate_hz": rate_hz})}
    )
    from acquisition.cameras.simulated import SimulatedCamera

    camera = SimulatedCamera(settings)
    camera.open()
    camera.start()
    frames = []
    for _ in range(count):
        frame = camera.read(5.0)
        assert frame is not None
        frames.append(frame.image)
    camera.close()
    return frames


def real_time(
    width: int,
    height: int,
    bits: Literal[8, 12],
    rate_hz: float,
    duration_s: float,
    *,
    watchers: Sequence[Watcher] = (),
    show: Callable[[Snapshot], None] = lambda _: None,
) -> dict[str, Any]:
    """One run in real time: frames lost, latency from frame to record, share of one core.

    The latency runs from the moment the camera hands a frame over to the end of the recorder's write
    call for it; the kernels are ready before the first frame, as they are in ``rig run``.
    """
    frames = drawn_frames(width, height, bits, rate_hz, round(min(2.0 * rate_hz, 600)))
    full_scale_dn = 2**bits - 1
    latencies_ms: list[float] = []
    original = Recorder._write

    def timed(self: Recorder, entry: Entry) -> None:
        original(self, entry)
        now_ns = time.monotonic_ns()
        latencies_ms.extend((now_ns - host_ns) * 1e-6 for host_ns in entry.host_times_ns)

    with tempfile.TemporaryDirectory() as folder:
        camera = MemoryCamera(frames, full_scale_dn, rate_hz, duration_s)
        opened = OpenCamera(camera, camera.open(), ())
        sensor = SensorModel(10_000.0 / full_scale_dn, 7.0, full_scale_dn)
        prepare_kernels(sensor, print)
        lever = Lever(arm_m=1.0, pixel_pitch_m=4.8e-6)
        optics = Optics(sensor, lever, Axes())
        file = RecordFile(
            Path(folder) / "run.mcap",
            validate_configuration({"camera": {"driver": "simulated"}}, "").model_copy(
                update={"lever": lever}
            ),
            Path(),
            opened,
            optics,
        )
        run = Run(
            RunParts(
                stream=FrameStream(camera, CameraSettings()),
                optics=optics,
                record=file,
                end=EndLimits(0.0, 1e9),
                watchers=watchers,
            )
        )
        Recorder._write = timed  # type: ignore[method-assign]
        before = resource.getrusage(resource.RUSAGE_SELF)
        began_s = time.monotonic()
        try:
            outcome = run.execute(show)
        finally:
            Recorder._write = original  # type: ignore[method-assign]
        elapsed_s = time.monotonic() - began_s
        after = resource.getrusage(resource.RUSAGE_SELF)
        size = (Path(folder) / "run.mcap").stat().st_size
    busy_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {
        "frames": outcome.snapshot.frames,
        "dropped": outcome.snapshot.dropped_frames,
        "latency_p50_ms": float(np.percentile(latencies_ms, 50)),
        "latency_p99_ms": float(np.percentile(latencies_ms, 99)),
        "latency_max_ms": float(np.max(latencies_ms)),
        "cores": busy_s / elapsed_s,
        "record_mb_per_s": size / elapsed_s / 1e6,
    }


def demo(config: str = "demo.toml") -> dict[str, Any]:
    """The whole demonstration as the user types it: time, memory, what was found."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "rig", "run", str(ROOT / "configs" / config), "-o", f"{folder}/out"]
        began_s = time.monotonic()
        done = subprocess.run([*command, "--runs", "1"], capture_output=True, text=True, check=False)
        elapsed_s = time.monotonic() - began_s
        if done.returncode:
            raise RuntimeError(done.stderr.strip().splitlines()[-1])
        run = json.loads((Path(folder) / "out" / "results.json").read_text())["runs"][0]
        record = Path(folder) / "out" / "run-1.mcap"
        simulated_s = run["frames"] / 100.0
        times_s = {}
        for name, words in (("replay", []), ("retrack", ["--retrack"])):
            began_s = time.monotonic()
            subprocess.run(
                [sys.executable, "-m", "rig", "replay", *words, str(record)], check=True, capture_output=True
            )
            times_s[name] = time.monotonic() - began_s
        began_s = time.monotonic()
        subprocess.run(
            [sys.executable, "-m", "rig", "fit", str(record), "-o", f"{folder}/fit"],
            check=True,
            capture_output=True,
        )
        times_s["fit"] = time.monotonic() - began_s
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "elapsed_s": elapsed_s,
        "frames": run["frames"],
        "dropped": run["dropped_frames"],
        "largest_process_mib": children.ru_maxrss / 1024,
        "replay_times_real_time": simulated_s / times_s["replay"],
        "retrack_times_real_time": simulated_s / times_s["retrack"],
        "fit_process_s": times_s["fit"],
        "exact": {
            name: value["value"]
            for name, value in run["fits"]["exact"].items()
            if isinstance(value, dict) and "value" in value
        },
    }


def help_time_s() -> float:
    """Best of five of ``rig --help``."""
    best = float("inf")
    for _ in range(5):
        began_s = time.monotonic()
        subprocess.run([sys.executable, "-m", "rig", "--help"], check=True, capture_output=True)
        best = min(best, time.monotonic() - began_s)
    return best


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers of this topic."""
    seconds = 5.0 if quick else 60.0
    results: dict[str, Any] = {}
    cases: tuple[tuple[str, int, int, Literal[8, 12], float], ...] = (
        ("500 frames/s of 640x480", 640, 480, 8, 500.0),
        ("2000 frames/s of 256x256", 256, 256, 8, 2000.0),
        ("100 frames/s of 1280x1024, 12 bit", 1280, 1024, 12, 100.0),
    )
    for label, width, height, bits, rate_hz in cases:
        results[label] = real_time(width, height, bits, rate_hz, seconds)
        numbers = ", ".join(f"{key} {value:.3g}" for key, value in results[label].items())
        print(f"{label}, {seconds:g} s: {numbers}")
    results["help_s"] = help_time_s()
    print(f"rig --help: {results['help_s']:.2f} s")
    results["demo"] = demo()
    print(f"demo: {results['demo']}")
    return results


if __name__ == "__main__":
    run("--quick" in sys.argv)
