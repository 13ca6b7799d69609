"""Camera to record, in real time from memory: drops, latency, processor time; and the demo as a whole.

Run as ``python -m tests.benchmarks pipeline [--quick]`` from the repository.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal

import numpy as np

from acquisition.camera import CameraSettings
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
from rig.view import RunningView
from tests.benchmarks.memory_camera import MemoryCamera, drawn_frames
from tests.benchmarks.process_camera import ProcessCamera

ROOT = Path(__file__).resolve().parents[2]
_BEGIN_S = 0.5


def real_time(
    width: int,
    height: int,
    bits: Literal[8, 12],
    rate_hz: float,
    duration_s: float,
    *,
    of: type[MemoryCamera] | type[ProcessCamera] = MemoryCamera,
    watchers: Sequence[Watcher] = (),
    show: Callable[[Snapshot], None] = lambda _: None,
    viewed: bool = False,
) -> dict[str, Any]:
    """One run in real time: frames lost, latency from frame to record, share of one core.

    The latency runs from the moment when a frame is due to the end of the recorder's write call for it; part
    of it is `taken`, the time until the camera's thread has the frame. The kernels are ready before the
    first frame, as they are in ``rig run``. The frames of the first `_BEGIN_S` wait until the record has been
    created and is on the disk, and are told apart.
    """
    frames = drawn_frames(width, height, bits, rate_hz, round(min(2.0 * rate_hz, 600)))
    full_scale_dn = 2**bits - 1
    latencies_ms: list[float] = []
    begin_ms: list[float] = []
    original = Recorder._write

    def timed(self: Recorder, entry: Entry) -> None:
        original(self, entry)
        now_ns = time.monotonic_ns()
        for number, due_ns in zip(entry.sequences, entry.device_times_ns, strict=True):
            into = begin_ms if number < _BEGIN_S * rate_hz else latencies_ms
            into.append((now_ns - due_ns) * 1e-6)

    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        if viewed:
            record = Path(folder) / "run.mcap"
            stack.enter_context(RunningView(record, "web", record.with_suffix(".rrd"), "measuring"))
        camera = of(frames, full_scale_dn, rate_hz, duration_s)
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
        if outcome.failure is not None:
            raise outcome.failure
        after = resource.getrusage(resource.RUSAGE_SELF)
        size = (Path(folder) / "run.mcap").stat().st_size
    camera.close()
    busy_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    taken_ms = np.array(camera.late_ns) * 1e-6
    return {
        "frames": outcome.snapshot.frames,
        "dropped": outcome.snapshot.dropped_frames,
        "taken_p99_ms": float(np.percentile(taken_ms, 99)),
        "taken_max_ms": float(np.max(taken_ms)),
        "latency_p50_ms": float(np.percentile(latencies_ms, 50)),
        "latency_p99_ms": float(np.percentile(latencies_ms, 99)),
        "latency_max_ms": float(np.max(latencies_ms)),
        "begin_max_ms": float(np.max(begin_ms)),
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
