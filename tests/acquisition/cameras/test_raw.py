"""Raw pixels with a sidecar: right, refused in one line, or what is lost of them counted."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.acquisition.cameras.made_films import NX, NY, picture, places
from tests.acquisition.cameras.test_files import play, refusal

COUNT, RATE_HZ = 12, 25.0
LAYOUT = {"width_px": NX, "height_px": NY, "pixel_format": "Mono8", "frame_rate_hz": RATE_HZ}


def pictures(bits: int = 8) -> NDArray[Any]:
    return np.array([picture(place, bits) for place in places(np.arange(COUNT) / RATE_HZ)])


def written(folder: Path, data: bytes, layout: dict[str, Any], name: str = "swing.raw.toml") -> Path:
    path = folder / "swing.raw"
    path.write_bytes(data)
    (folder / name).write_text("".join(f"{key} = {json.dumps(value)}\n" for key, value in layout.items()))
    return path


def packed_12p(frames: NDArray[Any]) -> bytes:
    """Two pixels in three bytes, least significant bits first."""
    first, second = frames.ravel()[::2].astype(np.uint32), frames.ravel()[1::2].astype(np.uint32)
    both = first | second << 12
    return np.stack([both & 255, both >> 8 & 255, both >> 16], axis=1).astype(np.uint8).tobytes()


@pytest.mark.parametrize(
    ("name", "layout", "data", "wanted"),
    [
        ("swing.raw.toml", {}, pictures().tobytes(), pictures()),
        ("swing.toml", {}, pictures().tobytes(), pictures()),
        ("swing.toml", {"header_bytes": 7}, b"a title" + pictures().tobytes(), pictures()),
        ("swing.toml", {"pixel_format": "Mono12"}, pictures(12).astype("<u2").tobytes(), pictures(12)),
        (
            "swing.toml",
            {"pixel_format": "Mono16", "byte_order": "big"},
            pictures(16).astype(">u2").tobytes(),
            pictures(16),
        ),
        ("swing.toml", {"pixel_format": "Mono12p"}, packed_12p(pictures(12)), pictures(12)),
        ("swing.toml", {"pixel_format": "RGB8"}, np.repeat(pictures(), 3).tobytes(), pictures()),
    ],
)
def test_pixels_and_times_come_back_as_they_are(
    tmp_path: Path, name: str, layout: dict[str, Any], data: bytes, wanted: NDArray[Any]
) -> None:
    path = written(tmp_path, data, LAYOUT | layout, name)
    camera, frames = play(path, frame_rate_hz=None)
    assert np.array_equal([frame.image for frame in frames], wanted)
    assert [frame.device_time_ns for frame in frames] == [40_000_000 * k for k in range(COUNT)]
    assert len(camera.remarks) == 1


def test_red_is_the_first_of_rgb_and_the_last_of_bgr(tmp_path: Path) -> None:
    colours = np.stack([pictures(), pictures() // 2, pictures() // 3], axis=-1)
    for order, stored in (("RGB8", colours), ("BGR8", colours[..., ::-1])):
        path = written(tmp_path, stored.tobytes(), LAYOUT | {"pixel_format": order})
        _, frames = play(path, frame_rate_hz=None, colour="red")
        assert np.array_equal([frame.image for frame in frames], pictures())


def test_without_times_they_come_from_elsewhere_or_are_asked_for(tmp_path: Path) -> None:
    layout = {key: value for key, value in LAYOUT.items() if key != "frame_rate_hz"}
    path = written(tmp_path, pictures().tobytes(), layout)
    _, frames = play(path, frame_rate_hz=50.0)
    assert frames[1].device_time_ns == 20_000_000
    assert "camera.files.frame_rate_hz" in refusal(path, frame_rate_hz=None)


def test_a_file_that_is_cut_off_is_counted_where_its_frames_are_stated(tmp_path: Path) -> None:
    data = pictures().tobytes()[: -3 * NX * NY // 2]
    path = written(tmp_path, data, LAYOUT | {"frames": COUNT})
    camera, frames = play(path, frame_rate_hz=None)
    assert (len(frames), camera.status.incomplete) == (COUNT - 2, 2)
    assert camera.remarks[1] == f"ends 2 frames before the {COUNT} that swing.raw.toml states"
    assert np.array_equal(frames[-1].image, pictures()[COUNT - 3])


WHOLE = pictures().tobytes()


@pytest.mark.parametrize(
    ("layout", "data", "said"),
    [
        ({"width_px": NX + 1}, WHOLE, "are not a whole number of frames of 161x96 px in Mono8 (15456 bytes)"),
        ({}, WHOLE[:-1], "state frames there if the file is cut off"),
        ({"frames": COUNT - 1}, WHOLE, "holds 15360 bytes more than the 11 frames"),
        ({"width_px": None}, WHOLE, "width_px: is missing"),
        ({"width_px": "160"}, WHOLE, "width_px = '160': should be a whole number"),
        ({"width_px": True}, WHOLE, "width_px = True: should be a whole number"),
        ({"frame_rate_hz": 0.0}, WHOLE, "frame_rate_hz = 0.0: should be greater than 0"),
        ({"width_px": None, "width": NX}, WHOLE, "width: unknown key; known here: width_px, height_px"),
        ({"pixel_format": "gray"}, WHOLE, "pixel_format = 'gray': should be one of Mono8, Mono10p"),
        ({"byte_order": "big"}, WHOLE, "byte_order: pixels of Mono8 have none"),
        ({"pixel_format": "Mono12", "frames": 6}, WHOLE, "is above 4095, the largest of Mono12"),
        ({"header_bytes": 10**9}, WHOLE, "not a whole number of frames"),
    ],
)
def test_a_sidecar_that_does_not_fit_is_refused_in_one_line(
    tmp_path: Path, layout: dict[str, Any], data: bytes, said: str
) -> None:
    stated = {key: value for key, value in (LAYOUT | layout).items() if value is not None}
    assert said in refusal(written(tmp_path, data, stated), frame_rate_hz=None)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("width_px = ", "swing.raw.toml: is not TOML"),
        ("width_px = 1\nwidth_px = 2", "swing.raw.toml: is not TOML"),
        ("width_px = inf", "width_px = inf"),
        ("\udcff", "swing.raw.toml: is not TOML"),
    ],
)
def test_a_file_that_is_no_sidecar_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = written(tmp_path, WHOLE, LAYOUT)
    (tmp_path / "swing.raw.toml").write_bytes(text.encode(errors="surrogateescape"))
    assert said in refusal(path, frame_rate_hz=None)


def test_a_sidecar_that_is_missing_is_asked_for(tmp_path: Path) -> None:
    path = written(tmp_path, WHOLE, LAYOUT)
    (tmp_path / "swing.raw.toml").unlink()
    assert "write swing.raw.toml with width_px, height_px, pixel_format" in refusal(path)
