"""Photon transfer: frames made by the sensor model of EMVA Standard 1288, measured by `rig calibrate sensor`.

The model: photons are Poisson, each pixel has its own response (PRNU) and its own dark signal (DSNU), the
electronics add normal noise, the converter divides by the gain, rounds and clips. The standard's own
estimator (release 4, linear model: gain from the slope of the temporal variance over the mean, both from two
frames, up to 70 % of saturation) is written here again, by its formula.
"""

import tempfile
import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.rig.command_line import rig
from tests.validation.row import Found

Image = NDArray[np.uint16]
SEEDS = 30
SHAPE = (120, 160)
FULL_SCALE_DN = 4095
LEVELS, DARKS = 12, 16


class Camera:
    """A sensor by the standard's linear model; all its numbers are known."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.gain_e_per_dn = float(rng.uniform(1.5, 4.0))
        self.dark_noise_e = float(rng.uniform(3.0, 9.0))
        self.prnu = float(rng.uniform(0.004, 0.012))
        self.dsnu_e = float(rng.uniform(0.5, 2.5))
        self.offset_dn = float(rng.uniform(40.0, 80.0))
        self._response = 1 + self.prnu * rng.standard_normal(SHAPE)
        self._dark_e = self.dsnu_e * rng.standard_normal(SHAPE)
        # what is true of the pixels that there are, not of those from which they were drawn
        self.offset_dn += float(self._dark_e.mean()) / self.gain_e_per_dn
        self.prnu = float(self._response.std() / self._response.mean())
        self._dark_e -= self._dark_e.mean()

    def frame(self, photoelectrons: float) -> Image:
        electrons = self.rng.poisson(photoelectrons * self._response) + self._dark_e
        electrons = electrons + self.dark_noise_e * self.rng.standard_normal(SHAPE)
        dn = electrons / self.gain_e_per_dn + self.offset_dn
        return np.clip(np.rint(dn), 0, FULL_SCALE_DN).astype(np.uint16)


def gain_by_the_standard(pairs: Sequence[tuple[Image, Image]], darks: Sequence[Image]) -> float:
    """The standard's estimator from the same frames, electrons a DN."""

    def temporal(a: Image, b: Image) -> tuple[float, float]:
        difference = a.astype(float) - b.astype(float)
        return float(a.mean() + b.mean()) / 2, float(0.5 * (np.mean(difference**2) - difference.mean() ** 2))

    dark_mean, dark_variance = temporal(darks[0], darks[1])
    means, variances = np.array([temporal(a, b) for a, b in pairs]).T
    used = means < 0.7 * FULL_SCALE_DN
    x, y = means[used] - dark_mean, variances[used] - dark_variance
    return float(x @ x / (x @ y))


def _measured(folder: Path, pairs: Sequence[tuple[Image, Image]], darks: Sequence[Image]) -> dict[str, float]:
    """What the command writes: values of the calibration file, and uncertainties of its details."""
    np.save(folder / "darks.npy", np.array(darks))
    lines = ['darks = "darks.npy"', f"full_scale_dn = {FULL_SCALE_DN}"]
    for number, pair in enumerate(pairs):
        np.save(folder / f"level{number}.npy", np.array(pair))
        lines += ["[[level]]", f'frames = "level{number}.npy"']
    (folder / "transfer.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    done = rig("calibrate", "sensor", "transfer.toml", cwd=folder)
    if done.returncode:
        raise RuntimeError(done.stderr.strip())
    written = tomllib.loads((folder / done.stdout.splitlines()[-1]).read_text(encoding="utf-8"))
    return {**written["details"], **written["values"]}


@cache
def photon_transfer() -> dict[str, Found]:
    """Pulls of gain, noise, dark level and PRNU against the truth; distance from the standard's."""
    pulls: dict[str, list[float]] = {"gain": [], "noise": [], "dark level": [], "prnu": []}
    from_standard, relative = [], []
    for seed in range(SEEDS):
        camera = Camera(np.random.default_rng([1288, seed]))
        full_e = (FULL_SCALE_DN - camera.offset_dn) * camera.gain_e_per_dn
        levels = [full_e * share for share in np.linspace(0.03, 0.9, LEVELS)]
        pairs = [(camera.frame(level), camera.frame(level)) for level in levels]
        darks = [camera.frame(0.0) for _ in range(DARKS)]
        with tempfile.TemporaryDirectory() as name:
            found = _measured(Path(name), pairs, darks)
        gain, u_gain = found["gain_e_per_dn"], found["u_gain_e_per_dn"]
        pulls["gain"].append((gain - camera.gain_e_per_dn) / u_gain)
        pulls["noise"].append((found["read_noise_e"] - camera.dark_noise_e) / found["u_read_noise_e"])
        pulls["dark level"].append((found["pedestal_dn"] - camera.offset_dn) / found["u_dark_level_dn"])
        pulls["prnu"].append((found["prnu"] - camera.prnu) / found["u_prnu"])
        from_standard.append(abs(gain / gain_by_the_standard(pairs, darks) - 1) * 100)
        relative.append(u_gain / gain * 100)
    return {
        **{
            name: Found(
                (float(np.sqrt(np.mean(np.square(values)))),),
                f"{SEEDS} sensors, worst {max(map(abs, values)):.1f} u",
            )
            for name, values in pulls.items()
        },
        "standard": Found(
            (max(from_standard),), f"{SEEDS} sensors; u of the gain is {np.median(relative):.2f} %"
        ),
    }
