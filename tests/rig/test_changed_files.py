"""Every file that the project reads, changed at random, gives one clear line or right answers."""

import io
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition.cameras.files.camera import FilesCamera
from acquisition.cameras.files.frame_source import FilesSettings
from acquisition.record.check import check_record, recover
from acquisition.record.reader import RecordReader
from acquisition.simulation.ground import read_ground_file
from calibration.store import read_calibration
from processing.errors import RigError
from rig.analysis import encoded, read_results
from rig.archive import list_runs
from rig.archive.listing import open_for_writing, write_sessions
from rig.intake.table import TableColumns
from rig.measure.session_file import SessionFile
from rig.prepare.calibration_inputs import LadderFile, TransferFile, read_input
from rig.prepare.learned_turns import read_turns
from rig.settings import load_configuration
from tests.acquisition.record.samples import write_sample
from tests.rig.command_line import SAMPLES

STRANGE = [b"\0", b"-1", b"1e400", b"nan", b"null", b"[" * 2000, b"{", b'"', b"9" * 30, b"\xff", b"\n", b"[]"]
FEW = settings(max_examples=25, suppress_health_check=list(HealthCheck))


@st.composite
def changes(draw: st.DrawFn) -> list[tuple[str, float, bytes]]:
    """Up to four changes: what, where (part of the length), with which bytes."""
    kinds = st.sampled_from(["flip", "replace", "insert", "delete", "cut", "repeat"])
    pieces = st.one_of(st.binary(min_size=1, max_size=8), st.sampled_from(STRANGE))
    places = st.floats(0.0, 1.0, exclude_max=True)
    return draw(st.lists(st.tuples(kinds, places, pieces), min_size=1, max_size=4))


def changed(data: bytes, wanted: list[tuple[str, float, bytes]]) -> bytes:
    for kind, where, piece in wanted:
        at = int(where * len(data))
        length = 1 + piece[0]
        if kind == "flip" and data:
            data = data[:at] + bytes([data[at] ^ 1 << piece[0] % 8]) + data[at + 1 :]
        elif kind == "replace":
            data = data[:at] + piece + data[at + len(piece) :]
        elif kind == "insert":
            data = data[:at] + piece + data[at:]
        elif kind == "delete":
            data = data[:at] + data[at + length :]
        elif kind == "cut":
            data = data[:at]
        else:
            data = data[:at] + data[at : at + length] + data[at:]
    return data


def one_line(use: Callable[[], Any], each_begins: str = "") -> Any:
    """What a reader returns; None where it gave one clear line, or one for each fault, which begins so."""
    said = "?"
    try:
        return use()
    except RigError as error:
        said = str(error)
    assert said
    lines = said.split("\n")
    assert len(lines) == 1 or each_begins
    assert all(line.startswith(each_begins) for line in lines)
    return None


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes, set[bytes]]:
    path = tmp_path_factory.mktemp("record") / "run.mcap"
    write_sample(path, 48, window_px=8)
    with RecordReader(path) as reader:
        rows = {row.tobytes() for row in reader.spots()}
    return path, path.read_bytes(), rows


@FEW
@given(wanted=changes())
def test_a_record(record: tuple[Path, bytes, set[bytes]], wanted: list[tuple[str, float, bytes]]) -> None:
    path, whole, rows = record
    path.write_bytes(changed(whole, wanted))
    copy = path.with_name("copy.mcap")

    def everything() -> None:
        with RecordReader(path) as reader:
            assert {row.tobytes() for row in reader.spots()} <= rows
            list(reader.windows())
            list(reader.images())
            reader.half_cycles(), reader.events(), reader.losses(), reader.attachments

    one_line(everything)
    one_line(lambda: check_record(path))
    if one_line(lambda: recover(path, copy)) is not None:
        with RecordReader(copy) as reader:
            assert {row.tobytes() for row in reader.spots()} <= rows
    copy.unlink(missing_ok=True)


def read_table(path: Path) -> None:
    found = TableColumns(None, (), "arcsec").read(path)
    assert np.all(np.diff(found.times_ns) >= 0)


def read_stack(path: Path) -> None:
    camera = FilesCamera(FilesSettings(path=path, frame_rate_hz=10.0))
    try:
        camera.open()
        camera.start()
        while camera.read(1.0) is not None:
            pass
    finally:
        camera.close()


def stored(kind: str) -> bytes:
    """A small image or stack of them, in the format of a file name's ending."""
    pixels = (np.arange(192) % 251).astype(np.uint8).reshape(12, 16)
    if kind == "npy":
        data = io.BytesIO()
        np.save(data, np.stack([pixels, pixels]))
        return data.getvalue()
    done, encoded = (
        cv2.imencodemulti(".tiff", [pixels, pixels]) if kind == "tiff" else cv2.imencode(f".{kind}", pixels)
    )
    assert done
    return encoded.tobytes()


LADDER = b"""u_reference = 0.1
arm_m = 1.5
pixel_pitch_m = 3.45e-6

[[step]]
reference = -60.0
x_px = 12.5
u_px = 0.01
"""
GROUND = b"time_s,acceleration_um_per_s2\n" + b"".join(b"%.2f,%d\n" % (n / 100, n % 7) for n in range(80))
TURN = b'{"utc": "2026-11-22T00:00:00+00:00", "weight": "a", "turns": 0.5, '
TURN += b'"before": [1.0, 2.0, 3e-6], "after": [1.5, 2.0, 3e-6], "u": [0.1, 0.1, 1e-7]}\n'
FILES: dict[str, tuple[Path | bytes, str, Callable[[Path], Any]]] = {
    "configuration": (SAMPLES / "session.toml", "session.toml", load_configuration),
    "session": (
        SAMPLES / "series" / "session.json",
        "session.json",
        lambda path: SessionFile.opened(path.parent).close(),
    ),
    "results": (
        SAMPLES / "series" / "results.json",
        "results.json",
        lambda path: json.dumps(encoded(read_results(path))),
    ),
    "calibration": (SAMPLES / "calibrations" / "lever-001.toml", "lever-001.toml", read_calibration),
    "table": (SAMPLES / "decay.csv", "decay.csv", read_table),
    "PGM": (b"P5 16 12 255\n" + bytes(range(192)), "frame0.pgm", lambda path: read_stack(path.parent)),
    "PNG": (stored("png"), "frame0.png", lambda path: read_stack(path.parent)),
    "TIFF stack": (stored("tiff"), "frames.tiff", read_stack),
    "NumPy stack": (stored("npy"), "frames.npy", read_stack),
    "ladder": (LADDER, "ladder.toml", lambda path: read_input(path, LadderFile)),
    "photon transfer": (
        b'darks = "dark"\n[[level]]\nframes = "1"\nexposure_us = 50.0\n',
        "t.toml",
        lambda path: read_input(path, TransferFile),
    ),
    "ground": (GROUND, "ground.csv", read_ground_file),
    "turned weights": (2 * TURN, "weights.jsonl", read_turns),
    "times": (b"time_ns,sequence\n10,0\n", "timestamps.csv", lambda path: read_stack(path.parent)),
}


@pytest.mark.parametrize("kind", FILES)
@FEW
@given(wanted=changes())
def test_a_file(kind: str, wanted: list[tuple[str, float, bytes]]) -> None:
    source, name, use = FILES[kind]
    data = source if isinstance(source, bytes) else source.read_bytes()
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        if kind == "times":
            (folder / "frame0.pgm").write_bytes(b"P5 16 12 255\n" + bytes(192))
        path = folder / name
        path.write_bytes(changed(data, wanted))
        one_line(lambda: use(path), str(path) if kind == "configuration" else "")


@settings(FEW, max_examples=5)
@given(wanted=changes())
def test_an_archive(wanted: list[tuple[str, float, bytes]]) -> None:
    with tempfile.TemporaryDirectory() as made:
        path, listed = Path(made) / "archive.duckdb", Path(made) / "listed.csv"
        with open_for_writing(path) as connection:
            write_sessions(connection, {"f": ""}, [{"sha256": "ab", "folder": "f", "b": 1e-3}])
        path.write_bytes(changed(path.read_bytes(), wanted))
        one_line(lambda: list_runs(path, "", "b", listed))


@pytest.mark.parametrize(
    "use",
    [
        RecordReader,
        load_configuration,
        read_calibration,
        read_results,
        lambda p: TableColumns(None, (), "").read(p),
    ],
)
def test_a_name_that_is_none(use: Callable[[Path], Any]) -> None:
    with pytest.raises(RigError, match=r"is not the name of a file|cannot be read"):
        use(Path("a\0b"))
