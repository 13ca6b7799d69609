"""Simulated rig: frames drawn per second, against numpy drawing every pixel; trajectories per second."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from acquisition.camera import CameraSettings
from acquisition.cameras.simulated import SimulatedCamera
from acquisition.simulation.optics import GaussianBeam, add_beam
from acquisition.simulation.settings import SimulationSettings
from acquisition.simulation.true_path import noisy, true_path, true_turning_points

_CASES: dict[str, tuple[dict[str, Any], CameraSettings]] = {
    "demonstration, 320x640, 8 bit": ({}, CameraSettings()),
    "turned ellipse, 8 bit": ({"optics": {"sigma_x_px": 7.0, "rotation_rad": 0.4}}, CameraSettings()),
    "12 bit": ({}, CameraSettings(pixel_format="mono12")),
    "PRNU, hot pixels, ghost": (
        {"sensor": {"prnu": 0.01, "hot_pixels": 200}, "optics": {"ghost_relative": 0.02}},
        CameraSettings(),
    ),
}


def _best_s(action: Callable[[], object], repeats: int) -> float:
    best_s = float("inf")
    for _ in range(repeats):
        begin_s = time.perf_counter()
        action()
        best_s = min(best_s, time.perf_counter() - begin_s)
    return best_s


def _numpy_frame(light_e: NDArray[np.float64], generator: np.random.Generator) -> NDArray[np.uint8]:
    """The same sensor, plainly: every pixel its Poisson and its normal number."""
    electrons = generator.poisson(light_e) + generator.normal(0.0, 7.0, light_e.shape)
    return np.clip(np.rint(electrons / 39.2 + 6.0), 0, 255).astype(np.uint8)


def _read(camera: SimulatedCamera, count: int) -> None:
    for _ in range(count):
        camera.read(1.0)


def run(quick: bool = False) -> dict[str, Any]:
    """Measured numbers; times are the best of interleaved repeats, in microseconds a frame."""
    repeats, count = (3, 100) if quick else (15, 400)
    light_e = np.zeros((640, 320))
    add_beam(light_e, GaussianBeam(160.3, 300.4, 6.0, 6.0, 0.0, 174 * 39.2), 0, 640, 0, 320)
    generator = np.random.default_rng(1)
    cameras = {}
    for name, (truth, asked) in _CASES.items():
        camera = SimulatedCamera(SimulationSettings.model_validate(truth))
        camera.open()
        camera.configure(asked)
        camera.start()
        _read(camera, 10)
        cameras[name] = camera
    numpy_us = float("inf")
    ours_us = dict.fromkeys(cameras, float("inf"))
    for _ in range(repeats):
        numpy_us = min(numpy_us, _best_s(lambda: _numpy_frame(light_e, generator), 3) * 1e6)
        for name, camera in cameras.items():
            read_s = _best_s(lambda camera=camera: _read(camera, count), 1)  # type: ignore[misc]
            ours_us[name] = min(ours_us[name], read_s / count * 1e6)
    settings = SimulationSettings()
    truth_s = _best_s(lambda: true_path(settings, 1200.0, 100.0), 5)
    turns_s = _best_s(lambda: true_turning_points(settings), 5)
    trajectory = true_path(settings, 1200.0, 100.0)
    noise_s = _best_s(lambda: noisy(trajectory, 1e-8, 1e-8, 1), 5)
    table = Table("simulated camera, one thread", "us/frame", "frames/s", "numpy / ours")
    table.add_row("numpy, every pixel drawn", f"{numpy_us:.0f}", f"{1e6 / numpy_us:.0f}", "1")
    for name, us in ours_us.items():
        table.add_row(name, f"{us:.0f}", f"{1e6 / us:.0f}", f"{numpy_us / us:.0f}")
    table.add_row("trajectory of 20 min at 100 frames/s, without images", f"{truth_s * 1e3:.1f} ms", "", "")
    table.add_row("its noise from a further seed", f"{noise_s * 1e3:.1f} ms", "", "")
    table.add_row("exact turning points of a run", f"{turns_s * 1e3:.1f} ms", "", "")
    Console().print(table)
    return {
        "numpy_us_per_frame": numpy_us,
        "us_per_frame": ours_us,
        "ratio_to_numpy": {name: numpy_us / us for name, us in ours_us.items()},
        "trajectory_20_min_s": truth_s,
        "trajectory_noise_s": noise_s,
        "turning_points_s": turns_s,
    }


if __name__ == "__main__":
    run()
