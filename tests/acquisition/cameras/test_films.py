"""Films with known truth: right, refused or counted. All of them: ``python -m tests.benchmarks inputs``."""

import logging
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from acquisition.cameras.files.film import FilmSource
from acquisition.cameras.files.film_index import film_index
from acquisition.cameras.files.sources import numbers_in
from tests.acquisition.cameras.film_cases import FRAMES, Outcome, cut, judged, matrix
from tests.acquisition.cameras.made_films import Film, picture, places, write_film
from tests.acquisition.cameras.test_files import frames_of, play, refusal, write_folder

CASES = {case.name: case for case in matrix()}
RIGHT = (
    "ffv1 mkv gray", "png mov gray", "png mov rgb48be", "rawvideo avi yuyv422", "rawvideo nut uyvy422",
    "v210 mov yuv422p10le", "huffyuv avi rgb24", "ffv1 mkv yuv420p10le", "full range", "colour, brightness",
    "h264 mp4", "vp9 webm", "mkv, 29.97 frames/s in ms", "mkv, 100 a second under 30", "mkv, starts at 1 s",
    "h264 mp4, four slices", "h264 mkv, intra refresh", "h265 mp4, three slices", "mp4, varying",
    "stated rate, the film's",
)  # fmt: skip


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)


def outcome(name: str, folder: Path) -> Outcome:
    return judged(CASES[name], folder)


@pytest.mark.parametrize("name", RIGHT)
def test_a_sound_film_is_read_right(tmp_path: Path, name: str) -> None:
    assert outcome(name, tmp_path).kind == "right"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("colour, nothing stated", "camera.files.colour = 'brightness'"),
        ("rawvideo nut rgb565le", "rgb565le, which is not read here"),
        ("h264 avi, no times", "another order than they are shown in"),
        ("h264 stream, no times", "has no display time"),
        ("stated rate, another", "frame_rate_hz = 25 puts frame 59 at 2.3600 s, the film itself at 1.9667 s"),
        ("stated rate, nearly", "force_frame_rate"),
        ("h264 mp4, cut off, index at the end", "cannot be read as a video"),
    ],
)
def test_what_cannot_be_read_right_is_refused_in_one_line(tmp_path: Path, name: str, said: str) -> None:
    found = outcome(name, tmp_path)
    assert found.kind == "refused"
    assert said in found.said


@pytest.mark.parametrize(
    "name",
    ["ffv1, bit 3", "h264 mp4, bit 0", "h264 mp4, four slices, bit 0",
     "h264 mp4, zeros", "h264 mp4, cut off", "ffv1, cut off",
     "h264 ts, zeros", "rawvideo avi, cut off", "h264 mkv, packets left out", "ffv1 mkv, packets left out"],
)  # fmt: skip
def test_what_a_damaged_film_lost_is_counted_and_the_rest_is_right(tmp_path: Path, name: str) -> None:
    assert outcome(name, tmp_path).kind == "counted"


def test_frames_missing_between_others_are_counted_placed_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    found = outcome("mp4, frames missing", tmp_path)
    assert (found.kind, found.said) == ("right", f"{FRAMES} of {FRAMES} delivered, 8 counted as lost")
    assert "8 frames are missing by the container's times: 7 after 0.667 s, 1 after 1.567 s" in caplog.text


def test_a_rate_that_the_film_contradicts_holds_where_it_is_forced(tmp_path: Path) -> None:
    film = Film(rate_hz=Fraction(25))
    path = write_film(tmp_path / "slow.mkv", [picture(place) for place in places(np.arange(9) / 25)], film)
    assert "contradict" not in refusal(path, frame_rate_hz=200.0)
    _, frames = play(path, frame_rate_hz=200.0, force_frame_rate=True)
    assert [frame.device_time_ns for frame in frames] == [5_000_000 * i for i in range(9)]


def test_whole_milliseconds_of_a_constant_rate_are_not_taken_for_its_times(tmp_path: Path) -> None:
    """Matroska keeps 0, 33, 67, 100 ms of 30 frames a second."""
    path = write_film(tmp_path / "film.mkv", [picture(np.array([80.0, 48.0]))] * 31, Film())
    index = film_index(path)
    assert (index.ticks[1], index.tick_s, index.rate_hz) == (33, Fraction(1, 1000), 30)
    assert index.time_ns[1] == 33_333_333
    assert index.time_ns[30] == 1_000_000_000


def test_the_summary_of_a_cut_film_counts_frames_and_time_alike(tmp_path: Path) -> None:
    path = write_film(tmp_path / "film.mkv", [picture(np.array([80.0, 48.0]))] * 31, Film())
    path.write_bytes(cut(0.6)(path.read_bytes()))
    source, stored = FilmSource(path), len(film_index(path).ticks)
    assert stored < source.count
    assert source.summary.startswith(f"{stored} frames in {(stored - 1) / 30:.6g} s, ")


def test_without_pyav_one_line_gives_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_film(tmp_path / "film.mkv", [picture(np.array([80.0, 48.0]))] * 3, Film())
    monkeypatch.setitem(sys.modules, "av", None)
    said = refusal(path, frame_rate_hz=None)
    assert "of the extra video: " in said
    assert said.endswith("pip install av, or convert it to a folder of images")


def test_a_damaged_film_is_silent_but_for_the_log(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    """Frames that are skipped one after another make one line."""
    assert outcome("h264 mp4, bit 0", tmp_path).kind == "counted"
    said = capfd.readouterr()
    assert "h264" not in said.out + said.err
    skipped = [record.message for record in caplog.records if "skipped" in record.message]
    assert 1 <= len(skipped) <= 3
    assert "more, to" in skipped[0]


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["f1.png", "f2.png", "f3.png"], [0, 1, 2]),
        (["f009.png", "f010.png", "f013.png", "f014.png"], [0, 1, 4, 5]),
        (["a_0000_raw.png", "a_0010_raw.png", "a_0020_raw.png"], [0, 1, 2]),
        (["a.png", "b.png", "c.png"], None),
        (["x1y1.png", "x2y2.png", "x3y3.png"], None),
        (["t1000.png", "t1033.png", "t1067.png", "t1101.png"], None),
        (["f1.png", "f01.png", "f2.png"], None),
        (["f1.png", "f3.png"], None),
    ],
)
def test_numbers_in_names_count_where_they_rise_evenly(names: list[str], numbers: list[int] | None) -> None:
    assert numbers_in(names) == numbers


def test_images_missing_from_a_folder_leave_a_gap_in_time(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A later frame would else come too early by the missing ones."""
    folder = write_folder(tmp_path / "images", frames_of(8, 12), ".png")
    for number in (4, 5, 9):
        (folder / f"frame{number}.png").unlink()
    camera, frames = play(folder)
    kept = [0, 1, 2, 3, 6, 7, 8, 10, 11]
    assert [frame.sequence for frame in frames] == kept
    assert [frame.device_time_ns for frame in frames] == [10_000_000 * i for i in kept]
    assert camera.status.dropped_by_camera == 3
    assert (
        "3 images are missing by the numbers in their names: between frame3.png to frame6.png" in caplog.text
    )
    _, frames = play(folder, numbering="order")
    assert [frame.sequence for frame in frames] == list(range(9))


def test_every_case_has_a_name_of_its_own() -> None:
    assert len(CASES) == len(matrix()) >= 60
