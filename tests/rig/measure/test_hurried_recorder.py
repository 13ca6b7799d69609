"""While much waits for the recorder it compresses less; nothing else changes."""

import threading
from pathlib import Path

import numpy as np

from acquisition.frame import Frame
from acquisition.record import pixels_beside
from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from rig.measure.recorder import Entry, Recorder

FRAMES = 12


class HeldWriter(RecordWriter):
    """Waits before its first image until it may go on, and notes how each one was compressed."""

    def __init__(self, path: Path) -> None:
        self.going_on = threading.Event()
        self.haste: list[bool] = []
        super().__init__(path, 0)

    def write_image(self, frame: Frame) -> None:
        assert self.going_on.wait(30.0)
        self.haste.append(self.hurried)
        super().write_image(frame)


def recorded(path: Path, images: list[np.ndarray], *, hurries: bool) -> list[bool]:
    writer = HeldWriter(path)
    recorder = Recorder(writer, hurries=hurries)
    for number, image in enumerate(images):
        recorder.put(Entry(images=[Frame(image, number, number * 10_000_000, 0)]))
    writer.going_on.set()
    recorder.close()
    assert recorder.error is None
    return writer.haste


def test_what_waits_is_compressed_less_and_comes_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    images = [rng.poisson(40, (1024, 1280)).astype(np.uint16) for _ in range(FRAMES)]
    haste = recorded(tmp_path / "hurried.mcap", images, hurries=True)
    assert haste[1]
    assert not haste[-1]
    assert not any(recorded(tmp_path / "calm.mcap", images, hurries=False))
    for name in ("hurried.mcap", "calm.mcap"):
        with RecordReader(tmp_path / name) as reader:
            for frame, image in zip(reader.images(), images, strict=True):
                np.testing.assert_array_equal(frame.image, image)
    hurried, calm = (pixels_beside(tmp_path / name).stat().st_size for name in ("hurried.mcap", "calm.mcap"))
    assert hurried > 1.1 * calm
