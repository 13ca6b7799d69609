"""The cases of the ledger: what is run, and what of its output is kept."""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

FRAME_RATE_HZ = 25.0
"""Slower than the simulated camera's own rate: the whole decay is kept, a case takes seconds."""

SIMULATED_TIME: Mapping[str, str] = {
    "simulation.real_time": "false",
    "controller.kind": "none",
    "laser.kind": "none",
    "environment_sensor.kind": "none",
    "start.way": "at once",
    "simulation.release.way": "let go",
}
"""What makes a session of the real-time configurations independent of the machine's pace."""


@dataclass(frozen=True)
class Case:
    """One command whose results are kept under a name."""

    name: str
    words: Sequence[str]
    """Words of the `rig` command, without ``-o``."""
    settings: Mapping[str, str] = field(default_factory=dict)
    """Keys of the configuration that are set for this case."""
    prepare: Callable[[Path], None] | None = None
    """Writes the input files into the folder in which the command is run."""
    status: int = 0
    """The exit status of the command."""


def exact_decay(time_s: np.ndarray) -> np.ndarray:
    """Position in mm of an exponentially decaying oscillation of 2 s, with time constant 150 s."""
    return 12.0 * np.exp(-time_s / 150.0) * np.cos(np.pi * time_s)


def write_table(folder: Path) -> None:
    """``decay.csv``: the exact decay, 20 samples a second for 200 s, in mm."""
    time_s = np.arange(4000) / 20.0
    with (folder / "decay.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(["t [s]", "x [mm]"])
        rows.writerows([f"{t:.2f}", f"{x:.7f}"] for t, x in zip(time_s, exact_decay(time_s), strict=True))


def write_film(folder: Path) -> None:
    """``film``: images of a Gaussian spot that moves as the exact decay, 10 px a mm, 20 images a second."""
    import cv2

    images = folder / "film"
    images.mkdir()
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:48, :320]
    for number in range(600):
        x_px = 160 + 10 * float(exact_decay(np.array([number / 20.0]))[0])
        light = 10 + 180 * np.exp(-((x - x_px) ** 2 + (y - 24) ** 2) / (2 * 4.0**2))
        image = np.rint(light + rng.normal(0, 1.0, light.shape)).clip(0, 255).astype(np.uint8)
        if not cv2.imwrite(str(images / f"{number:04d}.png"), image):
            raise OSError(f"{images}: image {number} could not be written")


def _session(name: str, settings: Mapping[str, str] | None = None, status: int = 0) -> Case:
    rate = {"simulation.clock.frame_rate_hz": str(FRAME_RATE_HZ)}
    return Case(name, ("run", f"configs/{name}.toml"), {**rate, **(settings or {})}, status=status)


_TO_300_S = {"session.max_duration_s": "300"}
_TO_2_ARCSEC = {"session.final_amplitude_arcsec": "2"}

CASES: Sequence[Case] = (
    _session("demo"),
    _session("glass", {"session.runs": "2"}),
    _session("silicon", {"session.runs": "1"}),
    _session("steel", {"session.runs": "1"}),
    _session("basement"),
    _session("vault", _TO_300_S),
    _session("live", {**SIMULATED_TIME, **_TO_300_S, **_TO_2_ARCSEC}),
    _session("faults", {**SIMULATED_TIME, **_TO_300_S, **_TO_2_ARCSEC}, status=1),
    Case("table", ("fit", "decay.csv"), prepare=write_table),
    Case("film", ("fit", "film", "--rate", "20"), prepare=write_film),
)
