"""A film that swings along x says so where half-cycles are looked for along y, and how they are found."""

import re
from pathlib import Path

import pytest

pytest.importorskip("av", reason="films are not read without PyAV: pip install av")

from calibration import Axes
from rig.analysis import read_results
from rig.analysis.half_cycle_fits import why_no_half_cycles
from tests.acquisition.cameras.made_films import Film, write_film
from tests.rig.command_line import rig
from tests.rig.intake.test_film_positions import PERIOD_S, swing


@pytest.mark.slow
def test_a_run_of_a_film_without_a_lever_names_the_direction_and_what_to_state(tmp_path: Path) -> None:
    film = write_film(tmp_path / "swing.mkv", swing(count=300), Film())
    config = tmp_path / "mine.toml"
    config.write_text(
        f"[camera]\ndriver = 'files'\n[camera.files]\npath = '{film.as_posix()}'\n[view]\nmode = 'none'\n",
        encoding="utf-8",
    )
    done = rig("run", config, "-o", tmp_path / "run", "--force")
    assert "no half-cycles" in done.stdout, done.stderr
    assert "the swing is along x" in done.stdout
    stated = re.search(r"--set (axes\.slow_angle_rad=[\d.]+)", done.stdout)
    assert stated is not None
    again = rig("run", config, "-o", tmp_path / "again", "--force", "--set", stated[1])
    (run,) = read_results(tmp_path / "again").runs
    assert run.half_cycles > 8, again.stderr
    value, u = run["mean_period_s"]
    assert abs(value - PERIOD_S) < 4 * u
    replayed = rig("replay", tmp_path / "run" / "run-1.mcap", "--set", stated[1])
    assert re.search(r"\d\d half-cycles", replayed.stdout), replayed.stderr


@pytest.mark.parametrize(
    ("ratio", "half_cycles", "axes", "words"),
    [
        (40.0, 0, None, "axes.slow_angle_rad=1.5708"),
        (400.0, 0, Axes(slow_angle_rad=1.57), "axes.slow_angle_rad=-0.00079633"),
        (40.0, 0, Axes(slow_angle_rad=-3.0), "axes.slow_angle_rad=-1.4292"),
        (40.0, 9, None, ""),
        (0.5, 0, None, ""),
    ],
)
def test_it_is_said_of_a_swing_across_that_gives_nothing(
    ratio: float, half_cycles: int, axes: Axes | None, words: str
) -> None:
    said = why_no_half_cycles("run-1.mcap", ratio, half_cycles, axes)
    assert bool(said) == bool(words)
    assert words in said
