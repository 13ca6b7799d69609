"""Speed of writing and reading records, compared with the writer and reader of the libraries.

Processor time of one thread, because the recorder shares the machine; ``wall`` where the disk takes part.
"""

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mcap_protobuf.writer import Writer
from rich.console import Console
from rich.table import Table

from acquisition.frame import Frame, Image
from acquisition.record import pixels_beside
from acquisition.record.check import check_record
from acquisition.record.mcap_file import McapFile
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover
from acquisition.record.schemas import MessageType
from acquisition.record.topics import SPOT, SWING, WINDOW
from acquisition.record.writer import RecordWriter, number_schemas, write_metadata
from processing.arrays import Floats
from processing.deflections import Deflections, DeflectionUnit
from processing.spot import Spot
from rig.commands.record_screen import print_info
from rig.measure.recorder import Entry, Recorder

BLOCK = 64
WINDOW_PX = 84
FRAME_SHAPE = (1024, 1280)
LIVE_RATE_HZ = 100
DAY_CHUNKS = 172_800
"""One a flush, every 0.5 s."""


def run(quick: bool = False) -> dict[str, Any]:
    """All numbers; `quick` takes fewer frames."""
    frames = 4_096 if quick else 40_960
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        results: dict[str, Any] = {}
        results |= _writing(folder, frames)
        results |= _reading(folder, folder / "ours.mcap", folder / "library.mcap")
        results |= _whole_frames(folder, 30 if quick else 150)
        results |= _whole_frames_live(folder, 2.0 if quick else 10.0)
        results |= _a_day(folder, DAY_CHUNKS // (20 if quick else 1))
    table = Table("record", "measured")
    for key, value in results.items():
        table.add_row(key, f"{value:,.4g}" if isinstance(value, float) else str(value))
    Console().print(table)
    return results


def _spot_image(rng: np.random.Generator, shape: tuple[int, int], bits: int) -> Image:
    """A laser spot with shot and read noise, 0.8 DN of 8 bit in the dark, as of real cameras."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    centre = (0.5 * shape[1] + rng.uniform(-2, 2), 0.5 * shape[0] + rng.uniform(-2, 2))
    electrons = 9000.0 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * 9.0**2)) + 400.0
    noisy = rng.poisson(electrons) + rng.normal(0.0, 30.0, shape)
    full = 2**bits - 1
    levels: Floats = np.clip(np.rint(noisy * full / 12_000.0 + 0.015 * full), 0, full)
    return levels.astype(np.uint8) if bits == 8 else levels.astype(np.uint16)


def _writing(folder: Path, frames: int) -> dict[str, Any]:
    """Spots and windows: what a frame costs, ours and the libraries' writer, block after block in turn."""
    rng = np.random.default_rng(1)
    images = [_spot_image(rng, (WINDOW_PX, WINDOW_PX), 8) for _ in range(512)]
    ours = RecordWriter(folder / "ours.mcap", 0)
    spot_class, window_class = _class(SPOT), _class(WINDOW)
    spent = {"ours spots": 0.0, "ours windows": 0.0, "library spots": 0.0, "library windows": 0.0}
    with (folder / "library.mcap").open("wb") as file:
        library = Writer(file)
        for first in range(0, frames, BLOCK):
            sequences = list(range(first, first + BLOCK))
            times = np.array(sequences, dtype=np.int64) * 10_000_000
            listed = times.tolist()
            values = rng.normal(100.0, 20.0, (BLOCK, 14))
            spots = [Spot._make([*row[:10], 0]) for row in values.tolist()]
            columns = values[:, 10:].T.copy()

            def our_spots(
                sequences: list[int] = sequences,
                listed: list[int] = listed,
                times: Any = times,
                spots: list[Spot] = spots,
                columns: Any = columns,
            ) -> None:
                x, y, u_x, u_y = columns
                deflections = Deflections(times, x, y, u_x, u_y, DeflectionUnit.RAD)
                ours.write_spots(sequences, listed, listed, spots, deflections)

            def our_windows(sequences: list[int] = sequences, listed: list[int] = listed) -> None:
                for sequence, time_ns in zip(sequences, listed, strict=True):
                    ours.write_window(sequence, time_ns, images[sequence % 512], 4, 5)

            def library_spots(
                sequences: list[int] = sequences,
                listed: list[int] = listed,
                spots: list[Spot] = spots,
                columns: Any = columns,
            ) -> None:
                x, y, u_x, u_y = columns.tolist()
                for row, (sequence, time_ns, spot) in enumerate(zip(sequences, listed, spots, strict=True)):
                    message = spot_class(
                        sequence=sequence, time_ns=time_ns, device_time_ns=time_ns, host_time_ns=time_ns,
                        x_rad=x[row], y_rad=y[row], u_x_rad=u_x[row], u_y_rad=u_y[row],
                        x_arcsec=x[row] * 2e5, y_arcsec=y[row] * 2e5, **spot._asdict(),
                    )  # fmt: skip
                    library.write_message("/spot", message, time_ns, time_ns, sequence)

            def library_windows(sequences: list[int] = sequences, listed: list[int] = listed) -> None:
                for sequence, time_ns in zip(sequences, listed, strict=True):
                    image = images[sequence % 512]
                    message = window_class(
                        sequence=sequence, time_ns=time_ns, x0_px=4, y0_px=5, width_px=WINDOW_PX,
                        height_px=WINDOW_PX, bytes_per_pixel=1, pixels=image.tobytes(),
                    )  # fmt: skip
                    library.write_message("/window", message, time_ns, time_ns, sequence)

            for name, work in (
                ("ours spots", our_spots),
                ("library spots", library_spots),
                ("ours windows", our_windows),
                ("library windows", library_windows),
            ):
                spent[name] += _cpu_s(work)
        spent["ours windows"] += _cpu_s(ours.close)
        spent["library windows"] += _cpu_s(library.finish)
    per_frame = {f"write, {name}, us a frame": 1e6 * value / frames for name, value in spent.items()}
    ours_us = 1e6 * (spent["ours spots"] + spent["ours windows"]) / frames
    library_us = 1e6 * (spent["library spots"] + spent["library windows"]) / frames
    sizes = {name: _size(folder / f"{name}.mcap") / frames for name in ("ours", "library")}
    return {
        **per_frame,
        "write, spot and window, us a frame": ours_us,
        "write, spot and window, frames/s of one core": 1e6 / ours_us,
        "write, speed against mcap_protobuf.Writer": library_us / ours_us,
        "write, spots alone, messages/s of one core": frames / spent["ours spots"],
        "size, spot and window of 84x84 px, bytes a frame": sizes["ours"],
        "size, against mcap_protobuf.Writer": sizes["ours"] / sizes["library"],
        "size, window pixels uncompressed, bytes a frame": float(WINDOW_PX * WINDOW_PX),
    }


def _reading(folder: Path, ours: Path, library: Path) -> dict[str, Any]:
    with RecordReader(ours) as reader:
        spots_s = _cpu_s(lambda: reader.spots())
        count = len(reader.spots())
        windows_s = _cpu_s(lambda: [window.sequence for window in reader.windows()])
    with library.open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()])
        library_s = _cpu_s(lambda: _drain(decoded.iter_decoded_messages(["/spot"], log_time_order=False)))
    check_s = _cpu_s(lambda: check_record(ours))
    recover_s = _cpu_s(lambda: recover(ours, folder / "recovered.mcap"))
    return {
        "read, spots/s out of a record with windows": count / spots_s,
        "read, spots, speed against mcap's reader": library_s / spots_s,
        "read, 118,000 spots, s": 118_000 * spots_s / count,
        "read, windows/s": count / windows_s,
        "check, MB/s of file": _size(ours) / check_s / 1e6,
        "recover, MB/s of file": _size(ours) / recover_s / 1e6,
    }


def _whole_frames(folder: Path, count: int) -> dict[str, Any]:
    """1280x1024 pixels, every frame, lossless, forced to the disk as always."""
    rng = np.random.default_rng(2)
    results: dict[str, Any] = {}
    for bits in (8, 12):
        images = [_spot_image(rng, FRAME_SHAPE, bits) for _ in range(4)]
        for kind in ("window", "image"):
            path = folder / f"frames-{bits}-{kind}.mcap"
            writer = RecordWriter(path, 0)
            wall_s = time.perf_counter()
            cpu_s = _cpu_s(partial(_write_frames, writer, images, count, kind))
            wall_s = time.perf_counter() - wall_s
            case = f"1280x1024 at {bits} bit as {kind}"
            results[f"{case}, frames/s of one core"] = count / cpu_s
            results[f"{case}, frames/s wall"] = count / wall_s
            results[f"{case}, compression"] = count * images[0].nbytes / _size(path)
            path.unlink()
            pixels_beside(path).unlink()
    return results


def _whole_frames_live(folder: Path, seconds: float) -> dict[str, Any]:
    """1280x1024 pixels at 100 frames/s through the recorder's thread, as in a run that keeps every frame.

    Cores needed are the whole process's time for the frames of a second; on a machine that is busy with
    other things fewer frames than that are handed over, and the longest wait is the recorder's queue.
    """
    rng = np.random.default_rng(4)
    results: dict[str, Any] = {}
    for bits in (8, 12):
        images = [_spot_image(rng, FRAME_SHAPE, bits) for _ in range(4)]
        path = folder / f"live-{bits}.mcap"
        recorder = Recorder(RecordWriter(path, 0))
        longest_s = 0.0
        began_s, began_cpu_s = time.perf_counter(), time.process_time()
        for sequence in range(round(seconds * LIVE_RATE_HZ)):
            due_s = began_s + sequence / LIVE_RATE_HZ
            time.sleep(max(0.0, due_s - time.perf_counter()))
            frame = Frame(images[sequence % len(images)], sequence, round(1e9 * sequence / LIVE_RATE_HZ), 0)
            handed_s = time.perf_counter()
            recorder.put(Entry(images=[frame]))
            longest_s = max(longest_s, time.perf_counter() - handed_s)
        sent_s = time.perf_counter() - began_s
        recorder.close()
        if recorder.error is not None:
            raise recorder.error
        case = f"1280x1024 at {bits} bit, every frame at 100 frames/s"
        results[f"{case}, frames/s handed over"] = round(seconds * LIVE_RATE_HZ) / sent_s
        cpu_s = time.process_time() - began_cpu_s
        results[f"{case}, cores needed"] = cpu_s / seconds
        results[f"{case}, longest wait, ms"] = 1e3 * longest_s
        results[f"{case}, left to write at the end, s"] = time.perf_counter() - began_s - sent_s
        path.unlink()
        pixels_beside(path).unlink()
    return results


def _write_frames(writer: RecordWriter, images: list[Image], count: int, kind: str) -> None:
    for sequence in range(count):
        image, time_ns = images[sequence % len(images)], sequence * 10_000_000
        if kind == "window":
            writer.write_window(sequence, time_ns, image, 0, 0)
        else:
            writer.write_image(Frame(image, sequence, time_ns, 0))
    writer.close()


def _a_day(folder: Path, chunks: int) -> dict[str, Any]:
    """A record with as many chunks as 24 h have: how long `info` takes, whole and cut."""
    path = folder / "day.mcap"
    own = {"schema_version": "1", "epoch_offset_ns": "0", "deflection_unit": "rad"}
    file = McapFile(path, number_schemas(DeflectionUnit.RAD), 0)
    write_metadata(file, {"record": own}, 0)
    spot, swing = SPOT.encode(*[0] * len(SPOT.numbers)), SWING.encode(*[0] * len(SWING.numbers))
    for place in range(chunks):
        file.add(SPOT.topic, place, place, spot)
        file.add(SWING.topic, place, place, swing)
        with file._writing() as writer:
            writer.flush()  # type: ignore[no-untyped-call]
    file.finish()
    whole_s = _wall_s(lambda: print_info(path))
    cut = folder / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-100])
    return {
        "info, chunks": chunks,
        "info, s": whole_s,
        "info of the same file cut short, s": _wall_s(lambda: print_info(cut)),
    }


def _class(kind: MessageType) -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(kind.descriptor).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(kind.full_name))


def _size(path: Path) -> int:
    """Bytes of a record's files."""
    return sum(file.stat().st_size for file in (path, pixels_beside(path)) if file.exists())


def _drain(items: Any) -> None:
    for _ in items:
        pass


def _cpu_s(work: Callable[[], Any]) -> float:
    began_s = time.thread_time()
    work()
    return time.thread_time() - began_s


def _wall_s(work: Callable[[], Any]) -> float:
    began_s = time.perf_counter()
    work()
    return time.perf_counter() - began_s


if __name__ == "__main__":
    run()
