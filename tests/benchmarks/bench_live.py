"""Live session under load: frames while the serial line hangs, memory and descriptors over days, balancing.

Run as ``python -m tests.benchmarks live [--quick]`` from the repository.
"""

import gc
import os
import resource
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from acquisition.camera import CameraSettings
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.simulation.settings import OpticsTruth, SensorTruth, SimulationSettings
from calibration.axes import Axes
from calibration.light_lever import Lever
from processing.spot import SensorModel
from rig.control.service import ControlService
from rig.control.settings import ControllerSettings, SerialFaults
from rig.control.simulated import simulated_controller
from rig.devices.frame_stream import FrameStream
from rig.devices.session_devices import Devices, OpenCamera
from rig.instrument.pipeline import Optics
from rig.measure.end_of_run import EndLimits
from rig.measure.record_file import RecordFile
from rig.measure.run import Run
from rig.measure.run_parts import RunParts
from rig.settings import Configuration, validate_configuration
from tests.benchmarks.memory_camera import MemoryCamera, drawn_frames
from tests.rig.balance.cases import follow_advice

_SENSOR = SensorModel(39.2, 7.0, 255)


def _simulated() -> Configuration:
    return validate_configuration({"camera": {"driver": "simulated"}}, "the benchmark")


def frames_beside_a_stuck_line(seconds: float) -> dict[str, Any]:
    """500 frames/s of 640x480 while every heartbeat waits for its whole timeout and retries."""
    settings = ControllerSettings(kind="simulated", timeout_s=0.2, faults=SerialFaults(delay_s=10.0))
    service = ControlService(simulated_controller(settings, 0.001), settings)
    devices = Devices(_simulated())
    devices.control = service
    frames = drawn_frames(640, 480, 8, 500.0, 600)
    with tempfile.TemporaryDirectory() as folder, service:
        camera = MemoryCamera(frames, 255, 500.0, seconds)
        opened = OpenCamera(camera, camera.open(), ())
        optics = Optics(_SENSOR, Lever(arm_m=1.0, pixel_pitch_m=4.8e-6), Axes())
        run = Run(
            RunParts(
                stream=FrameStream(camera, CameraSettings()),
                optics=optics,
                record=RecordFile(
                    Path(folder) / "run.mcap",
                    _simulated(),
                    Path(),
                    opened,
                    optics,
                ),
                end=EndLimits(0.0, 1e9),
                devices=devices,
            )
        )
        outcome = run.execute()
        snapshot = service.snapshot
    if outcome.failure is not None:
        raise outcome.failure
    return {
        "frames": outcome.snapshot.frames,
        "lost": outcome.snapshot.dropped_frames,
        "controller": str(snapshot.state),
        "last_error": snapshot.last_error,
    }


def soak(simulated_s: float, runs: int) -> dict[str, Any]:
    """Simulated time as fast as it goes, in several runs; memory and descriptors after each."""
    sensor = SensorTruth(width_px=48, height_px=160)
    settings = SimulationSettings(sensor=sensor, optics=OpticsTruth(arm_m=0.12, sigma_x_px=3, sigma_y_px=3))
    resident, descriptors, frames = [], [], 0
    begun_s = time.monotonic()
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            camera = SimulatedCamera(settings)
            opened = OpenCamera(camera, camera.open(), ())
            camera.configure(CameraSettings(frame_rate_hz=20.0))
            optics = Optics(_SENSOR, Lever(arm_m=0.12, pixel_pitch_m=4.8e-6), Axes())
            run = Run(
                RunParts(
                    stream=FrameStream(camera, CameraSettings(), policy="wait"),
                    optics=optics,
                    record=RecordFile(
                        Path(folder) / "run.mcap",
                        _simulated(),
                        Path(),
                        opened,
                        optics,
                    ),
                    end=EndLimits(0.0, simulated_s / runs),
                )
            )
            outcome = run.execute()
            camera.close()
            if outcome.failure is not None:
                raise outcome.failure
            frames += outcome.snapshot.frames
        gc.collect()
        resident.append(_resident_mib())
        descriptors.append(len(os.listdir("/proc/self/fd")))
    return {
        "simulated_h": simulated_s / 3600,
        "elapsed_s": time.monotonic() - begun_s,
        "frames": frames,
        "resident_mib": resident,
        "descriptors": descriptors,
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def balancing(cases: int) -> dict[str, Any]:
    """Moves until the advice is to leave it, from anywhere within 10 arcmin."""
    found = [follow_advice(seed) for seed in range(cases)]
    return {
        "cases": cases,
        "within_limits_in_five_moves": sum(case.within_limits and case.moves <= 5 for case in found),
        "moves": dict(sorted(Counter(case.moves for case in found).items())),
    }


def _resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2**20


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers of this topic."""
    results: dict[str, Any] = {}
    results["stuck line"] = frames_beside_a_stuck_line(5.0 if quick else 60.0)
    print(f"500 frames/s beside a serial line stuck in its timeout: {results['stuck line']}")
    results["soak"] = soak(3600.0 if quick else 86_400.0, 4 if quick else 8)
    print(f"soak: {results['soak']}")
    results["balancing"] = balancing(20 if quick else 100)
    print(f"balancing: {results['balancing']}")
    return results


if __name__ == "__main__":
    run("--quick" in sys.argv)
