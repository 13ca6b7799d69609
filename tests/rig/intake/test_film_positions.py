"""A film gives period, damping and a report with nothing but the file; dark objects, the size of a pixel."""

import csv
import json
import re
from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy

from processing.errors import ConfigurationError, DataError
from rig.analysis import read_results
from rig.analysis.table_fit import analyse_trajectory
from rig.intake.film import FilmOptions, film_trajectory, has_dark_object, inverted
from rig.terminal import ProgressLine
from tests.acquisition.cameras.made_films import NX, NY, Film, write_film
from tests.processing.fit.decays import ARCSEC, paper_pair
from tests.processing.fit.driven import driven_path
from tests.rig.command_line import rig

PERIOD_S, TAU_S, RATE_HZ = 1.7, 6.0, 30
DECREMENT = PERIOD_S / TAU_S


def noisy(lights: Iterable[np.ndarray], seed: int) -> list[np.ndarray]:
    """Pictures of this light, with noise, of eight bit."""
    rng = np.random.default_rng(seed)
    seen = (np.rint(light + 1.5 * rng.standard_normal(light.shape)) for light in lights)
    return [np.clip(picture, 0, 255).astype(np.uint8) for picture in seen]


Y, X = np.mgrid[:NY, :NX]


@cache
def swing(dark: bool = False, count: int = 450) -> list[np.ndarray]:
    """Pictures of a swing that dies away."""
    t = np.arange(count) / RATE_HZ
    places = 80.3 + 50.0 * np.exp(-t / TAU_S) * np.sin(2.0 * np.pi * t / PERIOD_S)
    away = (np.hypot(X - at, Y - 47.8) for at in places)
    if dark:
        return noisy((190.0 - 150.0 / (1.0 + np.exp(1.5 * (one - 7.0))) for one in away), 2)
    return noisy((180.0 * np.exp(-(one**2) / 50.0) + 20.0 for one in away), 2)


def test_from_a_film_to_a_report_with_one_command(tmp_path: Path) -> None:
    film = write_film(tmp_path / "swing.mkv", swing(), Film())
    done = rig("fit", film, "-o", tmp_path / "out", figures=True)
    assert done.returncode == 0, done.stderr
    assert "450 frames in 14.9667 s, 30 frames/s, ffv1, gray" in done.stdout
    assert "followed: a bright spot; 0 frames without one" in done.stdout
    results = read_results(tmp_path / "out")
    for name, true in (("mean_period_s", PERIOD_S), ("log_decrement", DECREMENT)):
        value, u = results[name]
        assert abs(value - true) < 4 * u < 0.01 * true
    (run,) = results.runs
    assert results.unit == run.amplitude_unit == "px"
    assert run.damping is not None
    assert list(run.damping.needed) == ["linear"]
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("<svg") + page.count("image/svg+xml") >= 2
    with (tmp_path / "out" / "positions.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time_s", "x [px]", "y [px]"]
    assert len(rows) == 451
    again = rig("fit", tmp_path / "out" / "positions.csv", "--position", "x [px]")
    assert "x [px] in px, 1 decay" in again.stdout


@pytest.mark.slow
def test_a_dark_object_is_followed_and_a_pixel_has_a_size(tmp_path: Path) -> None:
    film = write_film(tmp_path / "dark.mkv", swing(dark=True, count=120), Film())
    found = film_trajectory(film, FilmOptions(size="0.2 mm"))
    assert any(
        "a dark object (the picture is inverted); 0 frames without one" in line for line in found.understood
    )
    t = np.arange(120) / RATE_HZ
    true_mm = 0.2 * (80.3 + 50.0 * np.exp(-t / TAU_S) * np.sin(2.0 * np.pi * t / PERIOD_S))
    assert found.unit == "mm"
    # what amplitudes owe to compression: without a loss nothing
    assert found.u_common_over_noise == 0.0
    assert np.abs(found.positions[0] - true_mm).max() < 0.2 * 0.1
    assert film_trajectory(film, FilmOptions(size="85 mm over 425 px")).positions[0] == pytest.approx(
        found.positions[0]
    )
    for wrong in (
        "0.2",
        "85 mm over 425",
        "85 mm over 0 px",
        "85 mm over 4 mm",
        "over 4 px",
        "-1 mm",
        "nan mm",
    ):
        with pytest.raises(ConfigurationError, match="a number and a unit are needed"):
            film_trajectory(film, FilmOptions(size=wrong))


@pytest.mark.parametrize(("ground", "said"), [(190.0, ""), (300.0, "ground saturated in 100 %")])
def test_a_black_object_is_not_saturated_but_its_ground_may_be(
    tmp_path: Path, ground: float, said: str
) -> None:
    """Black is full scale of the inverted picture, which is no camera's."""
    places = 80.3 + 40.0 * np.sin(2.0 * np.pi * np.arange(30) / RATE_HZ / PERIOD_S)
    away = (np.hypot(X - at, Y - 47.8) for at in places)
    pictures = noisy((ground * (1.0 - 1.1 / (1.0 + np.exp(1.5 * (one - 7.0)))) for one in away), 4)
    found = film_trajectory(write_film(tmp_path / "black.mkv", pictures, Film()), FilmOptions())
    (followed,) = [line for line in found.understood if line.startswith("followed")]
    assert "a dark object" in followed
    assert "0 frames without one" in followed
    assert ("saturated" in followed) == bool(said)
    assert said in followed
    assert np.abs(found.positions[0] - places).max() < 0.1


def test_what_compression_does_to_all_amplitudes_is_in_the_uncertainty(tmp_path: Path) -> None:
    """H.264 makes amplitudes too small, which the scatter does not show."""
    film = Film(codec="libx264", ending="mp4", pixels="yuv420p", options={"crf": "28"})
    trajectory = film_trajectory(write_film(tmp_path / "lossy.mp4", swing(), film), FilmOptions())
    found = analyse_trajectory(tmp_path / "lossy.mp4", trajectory, None).longest
    assert "light that stays" not in " ".join(trajectory.understood)
    blind = replace(trajectory, u_common_over_noise=0.0)
    of_scatter = analyse_trajectory(tmp_path / "lossy.mp4", blind, None).longest
    error = found.number("log_decrement").value - DECREMENT
    assert abs(error) > 4 * of_scatter.number("log_decrement").standard_uncertainty
    assert abs(error) < 3 * found.number("log_decrement").standard_uncertainty < 0.05 * DECREMENT
    assert found.damping is not None
    assert of_scatter.damping is not None
    for wide, narrow in zip(found.damping.curve, of_scatter.damping.curve, strict=True):
        assert wide.time_constant_s.standard_uncertainty > narrow.time_constant_s.standard_uncertainty
    # a lag where the swing turns is as possible, and moves no mean
    (period_s, u), (same_s, u_of_scatter) = (one.number("mean_period_s") for one in (found, of_scatter))
    assert period_s == same_s
    assert u > u_of_scatter
    assert abs(period_s - PERIOD_S) < 3 * u


@pytest.mark.parametrize(
    ("codec", "ending", "pixels"),
    [("libx264", "mp4", "yuv420p"), ("libx264", "mkv", "yuv420p"), ("mpeg4", "avi", "yuv420p"),
     ("png", "mov", "gray")],
)  # fmt: skip
def test_of_pixels_that_are_not_square_x_is_as_a_viewer_shows_it(
    tmp_path: Path, codec: str, ending: str, pixels: str
) -> None:
    film = Film(codec=codec, ending=ending, pixels=pixels, pixel_aspect=Fraction(4, 3))
    wide = film_trajectory(
        write_film(tmp_path / f"wide.{ending}", swing(count=40), film), FilmOptions(size="2 mm")
    )
    square = replace(film, pixel_aspect=Fraction(1))
    plain = film_trajectory(
        write_film(tmp_path / f"plain.{ending}", swing(count=40), square), FilmOptions(size="2 mm")
    )
    # x264 encodes the same pictures into files that differ by chance, a few hundredths of a pixel at most
    rounding_mm = 2 * 0.1 if codec == "libx264" else 1e-9
    # counted from the middle of the first pixel of the picture as it is shown
    stretched_mm = 4 / 3 * (plain.positions[0] + 1.0) - 1.0
    assert wide.positions[0] == pytest.approx(stretched_mm, abs=rounding_mm)
    assert wide.positions[1] == pytest.approx(plain.positions[1], abs=rounding_mm)
    said = "pixels are not square, 4:3 wide to high: a viewer shows 213x96 px instead of 160x96"
    assert (said in wide.understood, said in plain.understood) == (True, False)
    assert "a pixel is 2 mm, x counted in pixels as a viewer shows them" in " ".join(wide.understood)


def test_a_film_without_anything_to_follow_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    pictures = [rng.integers(90, 110, (NY, NX)).astype(np.uint8) for _ in range(12)]
    film = write_film(tmp_path / "nothing.mkv", pictures, Film())
    with pytest.raises(DataError, match="there is nothing to follow"):
        film_trajectory(film, FilmOptions())


@pytest.mark.parametrize("sigma_px", [0.2, 0.6])
def test_a_spot_smaller_than_a_pixel_is_not_followed(tmp_path: Path, sigma_px: float) -> None:
    lights = []
    for k in range(30):
        edges_x, edges_y = np.arange(NX + 1) - 80.0 - 40.0 * np.sin(0.2 * k), np.arange(NY + 1) - 48.3
        share = [np.diff(scipy.stats.norm.cdf(edges, scale=sigma_px)) for edges in (edges_y, edges_x)]
        lights.append(20.0 + 200.0 * np.outer(*share))
    film = write_film(tmp_path / "small.mkv", noisy(lights, 5), Film())
    with pytest.raises(DataError, match=r"there is nothing to follow; .* 2 px across"):
        film_trajectory(film, FilmOptions())


def test_what_was_followed_is_named_where_there_is_no_decay(tmp_path: Path) -> None:
    still = write_film(tmp_path / "still.mkv", swing(count=1) * 60, Film())
    done = rig("fit", still)
    assert done.returncode == 1
    assert (
        "Followed: a bright spot; 0 frames without one, x 80.31 to 80.31 px and y 47.79 to 47.79 px"
        in done.stderr
    )
    assert "--position" not in done.stderr
    with pytest.raises(DataError, match="one frame of it can be read"):
        film_trajectory(write_film(tmp_path / "one.mkv", swing(count=1), Film()), FilmOptions())


def test_the_time_that_is_left_of_a_film_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film = write_film(tmp_path / "long.mkv", swing(count=40), Film())
    times_s = iter(np.arange(100.0) ** 2 / 10)
    film_trajectory(film, FilmOptions(), ProgressLine("film: frames", clock=lambda: float(next(times_s))))
    said = capsys.readouterr().err.splitlines()
    assert said[0] == "film: frames: 11 of 40, about 0:29 min left"
    assert 2 < len(said) < 40


@pytest.mark.parametrize(("part", "amplitude_px"), [(0.01, 50.0), (0.03, 40.0), (0.0, 50.0)])
def test_light_that_stays_where_it_is_is_said_and_taken_off(
    tmp_path: Path, part: float, amplitude_px: float
) -> None:
    """A reflection of 3 % beside the middle shifts the spot by ten times the noise of its position."""
    t = np.arange(180) / RATE_HZ
    true_px = 80.3 + amplitude_px * np.exp(-t / 20) * np.sin(2.0 * np.pi * t / PERIOD_S)
    of_spot, of_reflection = (
        180.0 * np.exp(-((X - at) ** 2 + (Y - 47.8) ** 2) / 72.0) for at in (true_px[:, None, None], 94.3)
    )
    np.save(tmp_path / "swing.npy", noisy(20.0 + of_spot + part * of_reflection, 7))
    found = film_trajectory(tmp_path / "swing.npy", FilmOptions(rate_hz=RATE_HZ))
    error_px = found.positions[0] - true_px
    assert np.std(error_px) < 0.01
    assert np.abs(error_px - error_px.mean()).max() < 0.04
    said = [line for line in found.understood if "light that stays" in line]
    assert len(said) == (part > 0)
    if said:
        shown = re.search(r"is, ([\d.]+) % of the spot at x (\d+), y (\d+) px .*; taken off", said[0])
        assert shown is not None
        found_part, at_x, at_y = map(float, shown.groups())
        assert found_part == pytest.approx(100 * part, rel=0.15)
        assert np.hypot(at_x - 94.3, at_y - 47.8) < 3


def test_dark_is_what_is_darker_than_the_middle() -> None:
    picture = np.full((50, 50), 100, np.uint8)
    picture[10:14, 10:14] = 20
    assert has_dark_object(picture)
    assert not has_dark_object(inverted(picture, 255))
    assert inverted(np.array([[0, 235, 250]], np.uint8), 235).tolist() == [[235, 0, 0]]


@pytest.mark.slow
def test_compression_is_a_line_in_the_budget_of_a_films_laws(tmp_path: Path) -> None:
    """The paper's decay on glass, as a camera of four pictures a second sees it."""
    _, _, path_rad = driven_path(*paper_pair("glass_k8"), q=0.0, seed=0, last_arcsec=60.0, frames_per_s=4.0)
    places = 80.3 + 0.5 * path_rad / ARCSEC
    spots = (180.0 * np.exp(-((X - at) ** 2 + (Y - 47.8) ** 2) / 50.0) + 20.0 for at in places)
    film = Film(codec="libx264", ending="mp4", pixels="yuv420p", rate_hz=Fraction(4))
    path = write_film(tmp_path / "swing.mp4", noisy(spots, 3), film)
    config = tmp_path / "mine.toml"
    config.write_text("[pendulum]\nmass_kg = 0.406\nball_radius_m = 0.00605\n")
    done = rig("fit", path, "--pixel", "2 arcsec", "--config", config, "-o", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    budget = json.loads((tmp_path / "out" / "results.json").read_text())["runs"][0]["budget"]["n"]["sources"]
    (line,) = [line for line in budget if line["source"] == "common_amplitude_rad"]
    assert line["contribution"] > 0.0
