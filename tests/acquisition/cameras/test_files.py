"""The files camera passes the conformance suite and reads every container and timestamps; faulty files."""

import shutil
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from acquisition.camera import Camera, CameraSettings, Frame, PixelFormat
from acquisition.cameras.files.camera import FilesCamera
from acquisition.cameras.files.frame_source import FilesSettings
from acquisition.cameras.files.sources import IMAGES, natural_key
from processing.errors import DeviceError
from tests.acquisition.cameras.conformance import CameraConformance, Unplug

COUNT, NY, NX = 24, 48, 64


def frames_of(bits: int, count: int = COUNT) -> NDArray[Any]:
    generator = np.random.default_rng(bits)
    values = generator.integers(0, 2**bits, (count, NY, NX))
    return values.astype(np.uint8 if bits <= 8 else np.uint16)


def write_folder(folder: Path, frames: NDArray[Any], ending: str) -> Path:
    folder.mkdir()
    for i, frame in enumerate(frames):
        assert cv2.imwrite(str(folder / f"frame{i}{ending}"), frame)
    return folder


def write_video(path: Path, frames: NDArray[Any]) -> Path:
    depth = cv2.CV_8U if frames.dtype == np.uint8 else cv2.CV_16U
    options = [cv2.VIDEOWRITER_PROP_IS_COLOR, 0, cv2.VIDEOWRITER_PROP_DEPTH, depth]
    codec = cv2.VideoWriter.fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, 100.0, (NX, NY), options)
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def play(
    path: Path, camera_settings: CameraSettings | None = None, **settings: Any
) -> tuple[FilesCamera, list[Frame]]:
    settings.setdefault("frame_rate_hz", 100.0)
    camera = FilesCamera(FilesSettings(path=path, **settings))
    camera.open()
    camera.configure(camera_settings or CameraSettings())
    camera.start()
    return camera, list(iter(lambda: camera.read(1.0), None))


def refusal(path: Path, **settings: Any) -> str:
    """The one line with which the frames are refused."""
    with pytest.raises(DeviceError) as caught:
        play(path, **settings)
    message = str(caught.value)
    assert "\n" not in message
    return message


class FilesConformance(CameraConformance):
    @pytest.fixture
    def source(self, tmp_path: Path) -> Path:
        raise NotImplementedError

    @pytest.fixture
    def camera(self, source: Path) -> Iterator[Camera]:
        camera = FilesCamera(FilesSettings(path=source, frame_rate_hz=100.0))
        yield camera
        camera.close()


class TestFolderConformance(FilesConformance):
    @pytest.fixture
    def source(self, tmp_path: Path) -> Path:
        return write_folder(tmp_path / "images", frames_of(8), ".png")

    @pytest.fixture
    def unplugged(self, source: Path, camera: Camera) -> tuple[Camera, Unplug]:
        return camera, lambda: shutil.rmtree(source)


class TestDeepVideoConformance(FilesConformance):
    PIXEL_FORMATS: ClassVar[tuple[PixelFormat, ...]] = ("mono16",)

    @pytest.fixture
    def source(self, tmp_path: Path) -> Path:
        return write_video(tmp_path / "video.mkv", frames_of(16))


@pytest.mark.parametrize("ending", [".png", ".pgm", ".tif", ".TIFF"])
@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_images_come_back_bit_for_bit(tmp_path: Path, ending: str, bits: int) -> None:
    wanted = frames_of(bits)
    folder = write_folder(tmp_path / "images", wanted, ending)
    (folder / "notes.txt").write_text("no image")
    camera, frames = play(folder, bit_depth=bits)
    assert camera.open().full_scale_dn == 2**bits - 1
    assert np.array_equal([frame.image for frame in frames], wanted)
    assert [frame.sequence for frame in frames] == list(range(COUNT))
    assert [frame.device_time_ns for frame in frames] == [i * 10_000_000 for i in range(COUNT)]


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("ending", [".mkv", ".avi"])
def test_lossless_video_comes_back_bit_for_bit(tmp_path: Path, ending: str, bits: int) -> None:
    wanted = frames_of(bits)
    camera, frames = play(write_video(tmp_path / f"video{ending}", wanted))
    assert np.array_equal([frame.image for frame in frames], wanted)
    camera.stop()
    camera.start()
    again = camera.read(1.0)
    assert again is not None
    assert np.array_equal(again.image, wanted[0])


def test_tiff_stack_and_npy_stack_come_back_bit_for_bit(tmp_path: Path) -> None:
    wanted = frames_of(16)
    np.save(tmp_path / "stack.npy", wanted)
    cv2.imwritemulti(str(tmp_path / "stack.tif"), list(wanted))
    for name in ("stack.npy", "stack.tif"):
        _, frames = play(tmp_path / name)
        assert np.array_equal([frame.image for frame in frames], wanted), name


def test_a_damaged_video_frame_and_what_builds_on_it_are_counted_and_not_delivered(tmp_path: Path) -> None:
    """The decoder delivers all as good: one flipped bit spoils the frames up to the next key frame."""
    wanted = frames_of(8)
    path = write_video(tmp_path / "whole.mkv", wanted)
    whole, frames = play(path)
    assert (whole.status.delivered, whole.status.incomplete) == (COUNT, 0)
    raw = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    packets = [raw.read()[1].tobytes() for _ in range(COUNT)]
    data = bytearray(path.read_bytes())
    at = data.find(packets[4]) + len(packets[4]) // 2
    data[at] ^= 0x10
    damaged = tmp_path / "damaged.mkv"
    damaged.write_bytes(data)
    camera, frames = play(damaged)
    assert all(np.array_equal(frame.image, wanted[frame.sequence]) for frame in frames)
    missing = sorted(set(range(COUNT)) - {frame.sequence for frame in frames})
    assert missing[0] == 4
    assert camera.status.incomplete == len(missing)
    assert len(frames) >= 12, "from the next key frame on they are good again"


def test_a_tiff_stack_that_is_cut_off_is_said_to_be(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    wanted = frames_of(16, 12)
    path = tmp_path / "stack.tif"
    cv2.imwritemulti(str(path), list(wanted))
    assert play(path)[0].status.incomplete == 0
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 10])
    camera, frames = play(path)
    assert 0 < len(frames) < 12
    assert all(np.array_equal(frame.image, wanted[frame.sequence]) for frame in frames)
    assert camera.status.incomplete >= 1
    assert "cut off" in caplog.text


def test_an_image_that_states_an_absurd_size_is_one_line(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "images", frames_of(8, 3), ".png")
    data = bytearray((folder / "frame1.png").read_bytes())
    data[16:24] = struct.pack(">II", 200_000, 200_000)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    (folder / "frame1.png").write_bytes(data)
    camera, frames = play(folder)
    assert [frame.sequence for frame in frames] == [0, 2]
    assert camera.status.incomplete == 1


def test_stack_is_mapped_not_loaded(tmp_path: Path) -> None:
    path = tmp_path / "large.npy"
    stack = np.lib.format.open_memmap(path, mode="w+", dtype=np.uint8, shape=(20_000, 480, 640))
    stack[-1, 3, 4] = 77
    del stack
    camera = FilesCamera(FilesSettings(path=path, frame_rate_hz=1000.0))
    # 6 GB: reading it would take far more memory and time than a test has
    assert camera.open().width_px == 640
    camera.start()
    assert camera.read(1.0) is not None
    camera.close()


@pytest.mark.parametrize("largest", [100, 255, 1000, 4095])
def test_pgm_with_any_largest_value_keeps_its_numbers(tmp_path: Path, largest: int) -> None:
    values = np.random.default_rng(1).integers(0, largest + 1, (NY, NX))
    (tmp_path / "images").mkdir()
    (tmp_path / "images/a.pgm").write_bytes(netpbm("P5", values, largest, "# made by hand\n"))
    camera, frames = play(tmp_path / "images")
    assert np.array_equal(frames[0].image, values)
    assert camera.open().full_scale_dn == {100: 255, 255: 255, 1000: 1023, 4095: 4095}[largest]


def netpbm(kind: str, image: NDArray[Any], largest: int = 255, comment: str = "") -> bytes:
    """One image as a binary portable map; of colours all are equal."""
    ny, nx = image.shape
    values = np.dstack([image] * 3) if kind == "P6" else image
    raster = values.astype(">u2" if largest > 255 else "u1")
    return f"{kind}\n{comment}{nx} {ny}\n{largest}\n".encode() + raster.tobytes()


def tiff(path: Path, images: NDArray[Any], note: str, directories: int = 1, **tags: int) -> Path:
    """Pixels one after another behind as many directories, the first of which has a note."""
    ny, nx = images[0].shape
    bits = 8 * images.itemsize
    note_at, text = 8, note.encode() + b"\0"
    pixels_at = note_at + len(text)
    pixels = images.astype(images.dtype.newbyteorder(">")).tobytes()
    data = bytearray(b"MM\0*" + bytes(4) + text + pixels)
    link = 4
    for k in range(directories):
        entries = {
            256: (4, nx), 257: (4, ny), 258: (3, bits), 259: (3, tags.get("compression", 1)), 262: (3, 1),
            273: (4, pixels_at + k * images[0].nbytes), 277: (3, 1), 278: (4, ny), 279: (4, images[0].nbytes),
        }  # fmt: skip
        data[link : link + 4] = struct.pack(">I", len(data))
        rows = [struct.pack(">HHIHH", tag, 3, 1, v, 0) if kind == 3 else struct.pack(">HHII", tag, 4, 1, v)
                for tag, (kind, v) in entries.items()]  # fmt: skip
        rows.insert(5, struct.pack(">HHII", 270, 2, len(text), note_at))
        data += struct.pack(">H", len(rows)) + b"".join(rows)
        link = len(data)
        data += bytes(4)
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(("kind", "bits"), [("P5", 8), ("P6", 8), ("P5", 12)])
def test_a_portable_map_is_read_and_a_cut_one_or_several_in_one_file_are_skipped(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: str, bits: int
) -> None:
    wanted = frames_of(bits, 3)[:, :20, :30]
    (tmp_path / "images").mkdir()
    maps = [netpbm(kind, image, 2**bits - 1, f"# P5 {k} 1\n") for k, image in enumerate(wanted)]
    for number, data in enumerate([*maps, b"".join(maps), maps[0], maps[0][:-1]]):
        (tmp_path / f"images/f{number}.pnm").write_bytes(data)
    camera, frames = play(tmp_path / "images")
    assert np.array_equal([frame.image for frame in frames], wanted[[0, 1, 2, 0]])
    assert camera.status.incomplete == 2
    assert "f3.pnm: skipped: the file holds several images" in caplog.text
    assert "f5.pnm: skipped: the file ends after" in caplog.text


def test_images_of_a_missing_file_of_several_leave_a_gap(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    images = frames_of(8, 10)
    (tmp_path / "images").mkdir()
    for number in (0, 2, 3, 4):
        path = tmp_path / f"images/f{number}.tif"
        cv2.imwritemulti(str(path), list(images[2 * number : 2 * number + 2]))
        path.write_bytes(path.read_bytes()[: -5 if number == 4 else None])
    camera, frames = play(tmp_path / "images")
    assert [frame.sequence for frame in frames] == [0, 1, 4, 5, 6, 7, 8]
    assert (camera.status.dropped_by_camera, camera.status.incomplete) == (2, 1)
    assert "2 images are missing by the numbers in their names: between f0.tif to f2.tif" in caplog.text


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(
    "note", ["ImageJ=1.53t\nimages=9\nframes=9\n", "ImageJ=1\nimages=9\nslices=9\n", '{"shape": [9, 48, 64]}']
)  # fmt: skip
def test_images_without_directories_of_their_own_are_read(tmp_path: Path, note: str, bits: int) -> None:
    """ImageJ (and tifffile) write one directory, a note of how many images follow, and their pixels."""
    wanted = frames_of(bits, 9)
    path = tiff(tmp_path / "stack.tif", wanted, note)
    assert np.array_equal([frame.image for frame in play(path)[1]], wanted)
    path = tiff(tmp_path / "more.tif", wanted, note, directories=9)
    assert np.array_equal([frame.image for frame in play(path)[1]], wanted)
    camera, frames = play(tiff(tmp_path / "short.tif", wanted[:4], note))
    # where there are no pixels any more there is the directory
    assert (4 <= len(frames) < 9, len(frames) + camera.status.incomplete) == (True, 9)


def test_a_note_of_images_that_are_none_of_a_film_is_one_line(tmp_path: Path) -> None:
    note = "ImageJ=1.53t\nimages=8\n{}hyperstack=true\n"
    said = refusal(tiff(tmp_path / "a.tif", frames_of(8, 8), note.format("channels=2\nframes=4\n")))
    assert "2 channels" in said
    said = refusal(tiff(tmp_path / "b.tif", frames_of(8, 8), note.format("slices=2\nframes=4\n")))
    assert "2 slices" in said
    said = refusal(tiff(tmp_path / "c.tif", frames_of(8, 8), note.format(""), compression=5))
    assert "8 images" in said


def test_a_folder_of_jpegs_is_read_as_what_it_is(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    y, x = np.mgrid[:NY, :NX]
    smooth = np.rint(20 + 200 * np.exp(-((x - 30) ** 2 + (y - 20) ** 2) / 50)).astype(np.uint8)
    camera, frames = play(write_folder(tmp_path / "images", np.array([smooth] * 3), ".JPG"))
    assert len(frames) == 3
    assert np.abs(frames[0].image.astype(float) - smooth).max() < 10
    assert camera.lossy == "jpeg"
    assert "the codec jpeg is usually lossy" in caplog.text


def test_natural_order() -> None:
    names = ["b10.png", "b9.png", "a100.png", "a20.png", "b9a.png", "7.png", "1²2.png", "1²10.png", "③.png"]
    wanted = ["1²2.png", "1²10.png", "7.png", "a20.png", "a100.png", "b9.png", "b9a.png", "b10.png", "③.png"]
    assert sorted(names, key=natural_key) == wanted


def test_unreadable_images_are_skipped_counted_and_leave_gaps(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    wanted = frames_of(8)
    folder = write_folder(tmp_path / "images", wanted, ".png")
    (folder / "frame3.png").write_bytes(b"no image at all")
    (folder / "frame4.png").write_bytes(b"")
    whole = (folder / "frame9.png").read_bytes()
    (folder / "frame9.png").write_bytes(whole[: len(whole) // 2])
    camera, frames = play(folder)
    good = [i for i in range(COUNT) if i not in (3, 4, 9)]
    assert [frame.sequence for frame in frames] == good
    assert [frame.device_time_ns for frame in frames] == [i * 10_000_000 for i in good]
    assert np.array_equal([frame.image for frame in frames], wanted[good])
    assert camera.status.incomplete == 3
    assert camera.status.delivered == COUNT - 3
    for name in ("frame3.png", "frame4.png", "frame9.png"):
        assert name in caplog.text


def test_colour_is_refused_unless_stated_and_grey_saved_as_colour_is_grey(tmp_path: Path) -> None:
    grey = frames_of(8)[0]
    folder = tmp_path / "images"
    folder.mkdir()
    cv2.imwrite(str(folder / "a.png"), np.dstack([grey, grey, grey]))
    _, frames = play(folder)
    assert np.array_equal(frames[0].image, grey)
    colours = np.dstack([grey, grey // 2, grey // 4])
    cv2.imwrite(str(folder / "a.png"), colours)
    assert "camera.files.colour" in refusal(folder)
    for name, wanted in (("blue", grey), ("green", grey // 2), ("red", grey // 4)):
        assert np.array_equal(play(folder, colour=name)[1][0].image, wanted), name
    mean = play(folder, colour="mean")[1][0].image
    assert np.abs(mean - colours.mean(axis=2)).max() <= 0.5


def test_region_is_cut_and_images_of_another_size_are_skipped_counted_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    wanted = frames_of(8)
    folder = write_folder(tmp_path / "images", wanted, ".png")
    for number in (5, 6):
        cv2.imwrite(str(folder / f"frame{number}.png"), wanted[5, :20, :30])
    region = CameraSettings(width_px=20, height_px=12, offset_x_px=3, offset_y_px=5)
    camera, frames = play(folder, region)
    assert np.array_equal(frames[0].image, wanted[0, 5:17, 3:23])
    assert [frame.sequence for frame in frames] == [i for i in range(COUNT) if i not in (5, 6)]
    assert camera.status.incomplete == 2
    assert "frame5.png and 1 more" in caplog.text
    assert "is 30x20 px" in caplog.text


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path / "images", frames_of(8, 4), ".png")


def timestamps(path: Path, text: str) -> dict[str, Any]:
    path.write_text(text)
    return {"timestamps_csv": path, "frame_rate_hz": None}


def test_times_from_csv_are_exact_to_the_nanosecond(folder: Path) -> None:
    rows = ["7,1700000000.123456789", "8,1700000000.133456789", "10,1700000001", "11,1700000001.000000001"]
    (folder / "timestamps.csv").write_text("\n".join(["sequence,time_s", *rows, ""]))
    camera, frames = play(folder, frame_rate_hz=None)
    assert [frame.device_time_ns for frame in frames] == [
        1700000000123456789,
        1700000000133456789,
        1700000001000000000,
        1700000001000000001,
    ]
    assert [frame.sequence for frame in frames] == [0, 1, 3, 4]
    assert camera.status.dropped_by_camera == 1


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("time_ns\n1\n2\n3\n", "3 rows of times for 4 frames"),
        ("time_ns\n1\n2\n3\n4\n5\n", "5 rows of times for 4 frames"),
        ("time_ns\n1\n3\n3\n4\n", "line 4: time_ns does not rise"),
        ("time_s\n1\n2\nthree\n4\n", "line 4: time_s = 'three'"),
        ("time_ns\n1.5\n2\n3\n4\n", "line 2: time_ns = '1.5'"),
        ("time_ns\n-1\n2\n3\n4\n", "negative"),
        ("time_s\nnan\n2\n3\n4\n", "line 2: time_s = 'nan'"),
        ("time_s\n1\n2\n3\n1e999999999\n", "line 5: time_s = '1e999999999' is not a number, or is too large"),
        ("time_ns\n1\n2\n3\n10000000000000000000\n", "rises above 9.2e18"),
        ("t\n1\n2\n3\n4\n", "no column time_ns or time_s"),
        ("", "is empty"),
        (
            "time_ns,file\n1,frame0.png\n2,frame1.png\n3,frame3.png\n4,frame2.png\n",
            "line 4 names 'frame3.png'",
        ),
    ],
)
def test_timestamps_that_do_not_fit_are_refused(folder: Path, tmp_path: Path, text: str, named: str) -> None:
    assert named in refusal(folder, **timestamps(tmp_path / "times.csv", text))


def test_no_times_at_all_names_both_ways(folder: Path) -> None:
    message = refusal(folder, frame_rate_hz=None)
    assert "frame_rate_hz" in message
    assert "timestamps.csv" in message
    with pytest.raises(ValidationError, match="not both"):
        FilesSettings(path=folder, timestamps_csv=folder / "timestamps.csv", frame_rate_hz=1.0)


def test_what_is_no_source_is_refused_in_one_line(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "absent")
    (tmp_path / "empty").mkdir()
    assert "holds no image" in refusal(tmp_path / "empty")
    (tmp_path / "text.mkv").write_text("no video")
    assert "cannot be read as a video" in refusal(tmp_path / "text.mkv")
    np.save(tmp_path / "flat.npy", np.zeros((3, 4)))
    assert "(n, ny, nx)" in refusal(tmp_path / "flat.npy")
    (tmp_path / "broken.npy").write_bytes(b"\x93NUMPY")
    assert "cannot be read as a .npy stack" in refusal(tmp_path / "broken.npy")
    np.save(tmp_path / "pickled.npy", np.array([{}], dtype=object), allow_pickle=True)
    assert "cannot be read as a .npy stack" in refusal(tmp_path / "pickled.npy")
    for ending in ("png", "jpg", "tif", "pgm", "webp"):
        path = tmp_path / f"one.{ending}"
        cv2.imwrite(str(path), frames_of(8)[0])
        assert "one image; name the folder" in refusal(path)
    (tmp_path / "swing.raw").write_bytes(bytes(NX * NY))
    assert "numpy.save('swing.npy', numpy.fromfile('swing.raw'" in refusal(tmp_path / "swing.raw")
    (tmp_path / "empty/a.heic").write_bytes(b"x")
    assert "holds no image (.png," in (said := refusal(tmp_path / "empty"))
    assert "but 1 .heic" in said
    folder = tmp_path / "bad"
    folder.mkdir()
    (folder / "a.png").write_bytes(b"x")
    assert "none of the 1 frames" in refusal(folder)
    for name, bits in (("b.png", 8), ("c.png", 16)):
        cv2.imwrite(str(folder / name), frames_of(bits)[0])
    assert "those of" in (said := refusal(folder))
    assert "convert them to one depth" in said


def test_real_beams_run_through(shared_data: Path, tmp_path: Path) -> None:
    shapes = []
    for image in sorted((shared_data / "beams").iterdir()):
        if image.suffix in IMAGES:
            folder = tmp_path / image.stem
            folder.mkdir()
            shutil.copy(image, folder)
            camera, frames = play(folder, frame_rate_hz=10.0)
            assert camera.status.incomplete == 0
            shapes += [frame.image.shape for frame in frames]
    assert len(shapes) == 7
    assert set(shapes) == {(960, 1280), (800, 800)}
