"""Uniformly lit and dark frames of the simulated camera."""

import numpy as np
from numpy.typing import NDArray

from acquisition.simulation.inputs import FaultSettings
from acquisition.simulation.scene import Scene, SensorSettings
from acquisition.simulation.settings import OpticsTruth, SensorTruth, SimulationSettings

Image = NDArray[np.uint8] | NDArray[np.uint16]


def even_frames(
    sensor: SensorTruth, exposure_us: float, count: int, *, seed: int, run: int, ambient_dn: float
) -> list[Image]:
    """Frames of the whole sensor; `ambient_dn` is the light at 100 us."""
    settings = SimulationSettings(
        seed=seed,
        sensor=sensor.model_copy(update={"ambient_dn": ambient_dn}),
        optics=OpticsTruth(peak_dn=0),
    )
    readings = SensorSettings(
        0, 0, sensor.width_px, sensor.height_px, sensor.bit_depth, exposure_us, 0.0, 100.0
    )
    scene = Scene(settings, FaultSettings(), readings, run)
    plan = scene.plan(count)
    return list(scene.draw(plan, slice(0, count)))


def random_sensor(rng: np.random.Generator, size: int = 64) -> SensorTruth:
    """A sensor whose noise in the dark is resolved by its converter."""
    depth = int(rng.choice([8, 10, 12]))
    gain = 10_000.0 / (2**depth - 1) * rng.uniform(0.9, 1.05)
    read_noise_e = gain * rng.uniform(0.6, 1.5) if depth < 12 else rng.uniform(3.0, 9.0)
    return SensorTruth(
        width_px=size,
        height_px=size,
        bit_depth=depth,  # type: ignore[arg-type]
        gain_e_per_dn=gain,
        full_well_e=15_000.0,
        read_noise_e=read_noise_e,
        black_level_dn=rng.uniform(6.0, 12.0) * read_noise_e / gain + 2.0,
        prnu=rng.uniform(0.005, 0.01),
        hot_pixels=3,
    )


def transfer_frames(
    sensor: SensorTruth, seed: int, levels: int = 9
) -> tuple[list[tuple[Image, Image]], list[Image], list[float]]:
    """Pairs over nine exposures up to three quarters of full scale, eight darks, the exposures."""
    exposures = np.linspace(10.0, 95.0, levels).tolist()
    light = 0.8 * (2**sensor.bit_depth - 1)
    darks = even_frames(sensor, 100.0, 8, seed=seed, run=0, ambient_dn=0.0)
    pairs = []
    for number, exposure in enumerate(exposures):
        first, second = even_frames(sensor, exposure, 2, seed=seed, run=1 + number, ambient_dn=light)
        pairs.append((first, second))
    return pairs, darks, exposures
