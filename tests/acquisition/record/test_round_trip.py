"""Values read from a record are identical to those written."""

import math
import struct
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition.camera import CameraInfo, ShutterKind
from acquisition.record.digest import RecordedCamera, camera_metadata
from acquisition.record.events import Event
from acquisition.record.reader import RecordReader
from acquisition.record.schemas import MessageType, message_type_of
from acquisition.record.topics import (
    ENVIRONMENT,
    EVENT,
    HALF_CYCLE,
    REFERENCE,
    SEISMOMETER,
    SPOT,
    TYPES_BY_UNIT,
    WINDOW,
    ClockAnchor,
    Environment,
    RecordedLosses,
)
from acquisition.record.writer import RecordWriter
from processing.balance import names_with_units
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RecordError
from processing.spot import Spot
from processing.swing import HalfCycle
from processing.units import ARCSEC_RAD
from tests.acquisition.record.samples import (
    EPOCH_OFFSET_NS,
    FRAME_NS,
    same_bits,
    sample_balance,
    write_sample,
)
from tests.acquisition.record.samples import SPOT as SPOT_OF_ONES

OF_DEFLECTIONS = [kind for kinds in TYPES_BY_UNIT.values() for kind in kinds]
ALL_TYPES = [*OF_DEFLECTIONS, WINDOW, EVENT, ENVIRONMENT, SEISMOMETER, REFERENCE]
ANY_DOUBLE = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True, width=64)
ANY_INT = st.integers(-(2**63), 2**63 - 1)
VALUES = {"double": ANY_DOUBLE, "int": ANY_INT, "text": st.text(), "bytes": st.binary()}


def bits(values: tuple[Any, ...]) -> list[Any]:
    return [struct.pack("<d", value) if isinstance(value, float) else value for value in values]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ALL_TYPES, ids=lambda kind: kind.name)
@given(data=st.data())
@settings(max_examples=20, deadline=None)
def test_any_values_come_back(kind: MessageType, data: st.DataObject) -> None:
    values = tuple(data.draw(VALUES[sort]) for _, sort in kind.fields)
    assert bits(kind.decode(kind.encode(*values))) == bits(values)


@given(rows=st.lists(st.tuples(*[VALUES[sort] for _, sort in SPOT.fields]), max_size=5))
@settings(max_examples=40, deadline=None)
def test_a_table_of_many_is_the_same_as_one_by_one(rows: list[tuple[Any, ...]]) -> None:
    table = SPOT.decode_table(b"".join(SPOT.encode(*row) for row in rows))
    assert [bits(tuple(row)) for row in table.tolist()] == [bits(row) for row in rows]


@given(data=st.binary(max_size=60))
@settings(max_examples=100, deadline=None)
def test_any_bytes_decode_or_raise_value_error(data: bytes) -> None:
    for kind in (SPOT, EVENT):
        try:
            kind.decode(data)
        except ValueError:
            continue


def test_rows_are_those_of_the_messages_one_by_one(tmp_path: Path) -> None:
    path, rng = tmp_path / "run.mcap", np.random.default_rng(0)
    with RecordWriter(path, EPOCH_OFFSET_NS, flush_interval_s=1e9) as writer:
        for block, count in enumerate([1, 3, 1, 7, 5, 2] * 4):
            numbers = range(100 * block, 100 * block + count)
            times_ns = np.array(numbers) * FRAME_NS
            spots = [Spot(*rng.standard_normal(len(Spot._fields) - 1), 0) for _ in numbers]
            deflections = Deflections(times_ns, *rng.standard_normal((4, count)), DeflectionUnit.RAD)
            writer.write_spots(
                numbers,
                times_ns.tolist(),
                times_ns.tolist(),
                spots,
                deflections,
                spots[: count * (block % 2)],
            )
            # as long as a reference, which it follows
            writer.write(RecordedLosses(int(times_ns[0]), *range(8)))
            writer.write_event(int(times_ns[0]), "kind", "x" * block)
            if block % 5 == 4:
                writer.flush()
    with RecordReader(path) as reader:
        for kind in (SPOT, REFERENCE):
            one_by_one = [kind.decode(message.data) for message in reader.messages(kind.topic)]
            table = reader.table(kind.topic)
            assert table.tolist() == one_by_one
            pieces = [reader.table(kind.topic, piece) for piece in reader.unread()]
            # every piece is given once, so that the second kind has none
            assert kind is REFERENCE or np.concatenate(pieces).tobytes() == table.tobytes()
        spots = reader.spots()
        assert (len(spots), len(reader.table(REFERENCE.topic))) == (76, 48)
        assert [losses[1:] for losses in reader.values(RecordedLosses)] == [tuple(range(8))] * 24
        for start_ns in (
            0,
            int(spots["time_ns"][9]),
            int(spots["time_ns"][9]) + 1,
            int(spots["time_ns"][-1]),
        ):
            rest = np.concatenate(list(reader.spot_blocks(start_ns, ("x_px",))))
            assert rest.tolist() == spots[["time_ns", "x_px"]][spots["time_ns"] >= start_ns].tolist()
        assert list(reader.spot_blocks(10**15)) == []
        assert len(reader.events()) == 24


def test_messages_of_another_length_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordWriter(path, 0) as writer:
        writer._numbers.add(SPOT.topic, 0, 0, HALF_CYCLE.encode(*[0] * len(HALF_CYCLE.fields)))
    with RecordReader(path) as reader:
        for read in (reader.spots, lambda: reader.table(SPOT.topic, next(reader.unread()))):
            with pytest.raises(RecordError, match="/spot has other fields than this version writes"):
                read()


@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_a_whole_record_comes_back(tmp_path: Path, dtype: str) -> None:
    path = tmp_path / "run.mcap"
    wrote = write_sample(path, dtype=dtype)
    with RecordReader(path) as reader:
        table = reader.spots()
        for name in Spot._fields:
            assert same_bits(table[name], np.array([getattr(spot, name) for spot in wrote.spots]))
        for name, column in zip(("x_rad", "y_rad", "u_x_rad", "u_y_rad"), wrote.deflections, strict=True):
            assert same_bits(table[name], column)
        assert same_bits(table["y_arcsec"], wrote.deflections[1] / ARCSEC_RAD)
        assert table["sequence"].tolist() == list(range(128))
        assert table["time_ns"].tolist() == [i * FRAME_NS for i in range(128)]
        assert table["host_time_ns"].tolist() == [i * FRAME_NS + 123 for i in range(128)]
        assert reader.half_cycles() == wrote.half_cycles
        windows = list(reader.windows())
        for window, (sequence, pixels, origin) in zip(windows, wrote.windows, strict=True):
            assert (window.sequence, window.origin_px) == (sequence, origin)
            assert window.time_ns == sequence * FRAME_NS
            np.testing.assert_array_equal(window.image, pixels)
        for image, frame in zip(reader.images(), wrote.images, strict=True):
            assert (image.sequence, image.time_ns) == (frame.sequence, frame.time_ns)
            np.testing.assert_array_equal(image.image, frame.image)
        assert reader.events() == [
            Event(0, "start", "first frame"),
            Event(128 * FRAME_NS, "stop", "amplitude below 2 arcsec"),
        ]
        begun, _ = (Log.FromString(message.data) for message in reader.messages("/log"))
        assert (begun.level, begun.name, begun.message) == (2, "event", "start: first frame")
        blocks = list(reader.spot_blocks())
        assert np.concatenate(blocks).tobytes() == table.tobytes()
        fields = ["sequence", "time_ns", "u_y_rad"]
        some = np.concatenate(list(reader.spot_blocks(fields=fields)))
        assert sorted(some.dtype.names or ()) == sorted(fields)
        assert all(some[name].tobytes() == table[name].tobytes() for name in fields)
        assert reader.balances() == wrote.balances
        environment = reader.values(Environment)
        assert environment[0].temperature_c == 21.5
        assert math.isnan(environment[0].humidity_percent)
        assert reader.attachments == {"configuration.toml": b"[session]\n", "any.bin": bytes(range(256))}
        assert reader.metadata["session"] == {"operator": "Ä. Tester", "notes": "line 1\nline 2"}
        assert reader.epoch_offset_ns == EPOCH_OFFSET_NS
        assert not reader.truncated
        assert reader.damages == []
        first = next(reader.messages("/spot"))
        assert first.log_time_ns == EPOCH_OFFSET_NS


def test_without_calibration_the_file_says_px(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    wrote = write_sample(path, unit=DeflectionUnit.PX)
    with RecordReader(path) as reader:
        assert reader.deflection_unit == "px"
        names = reader.table("/spot").dtype.names or ()
        assert "y_deflection_px" in names
        assert not any(name.endswith("arcsec") or name == "y_rad" for name in names)
        assert "y_rad" not in (reader.spots().dtype.names or ())
        deflections = reader.deflections()
        assert deflections.unit is DeflectionUnit.PX
        assert same_bits(deflections.y, wrote.deflections[1])
        assert reader.half_cycles() == wrote.half_cycles
        assert "amplitude_px" in (reader.table("/swing").dtype.names or ())


def test_deflections_in_another_unit_than_the_records_are_refused(tmp_path: Path) -> None:
    in_px = Deflections(np.array([0]), *np.ones((4, 1)), DeflectionUnit.PX)
    with (
        RecordWriter(tmp_path / "run.mcap", 0) as writer,
        pytest.raises(ValueError, match="its deflections are in rad; values in px"),
    ):
        writer.write_spots([0], [0], [0], [SPOT_OF_ONES], in_px)


@pytest.mark.parametrize("unit", DeflectionUnit)
def test_a_balance_comes_back_in_the_unit_of_its_record(tmp_path: Path, unit: DeflectionUnit) -> None:
    rng = np.random.default_rng(0)
    wrote = sample_balance(rng, 7, unit)
    with RecordWriter(tmp_path / "run.mcap", 0, deflection_unit=unit) as writer:
        writer.write_balance(wrote)
        (other,) = set(DeflectionUnit) - {unit}
        with pytest.raises(ValueError, match=f"its deflections are in {unit}; values in {other}"):
            writer.write_balance(sample_balance(rng, 7, other))
    with RecordReader(tmp_path / "run.mcap") as reader:
        names = reader.table("/balance").dtype.names or ()
        assert names == tuple(names_with_units(unit).values())
        assert reader.balances() == [wrote]


def test_a_record_without_frames_is_a_record(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    RecordWriter(path, 0).close()
    with RecordReader(path) as reader:
        assert len(reader.spots()) == 0
        assert reader.spots().dtype == SPOT.table_dtype
        assert reader.half_cycles() == []
        assert list(reader.windows()) == []
        assert not reader.truncated


def test_a_cameras_missing_clock_and_negative_times_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordWriter(path, EPOCH_OFFSET_NS) as writer:
        deflections = Deflections(np.array([-5]), *np.ones((4, 1)), DeflectionUnit.RAD)
        writer.write_spots([4], [-1], [-5], [SPOT_OF_ONES], deflections)
    with RecordReader(path) as reader:
        row = reader.spots()[0]
        assert (row["device_time_ns"], row["host_time_ns"], row["time_ns"]) == (-1, -5, -5)


def test_truth_values_and_numpys_numbers_are_whole_numbers(tmp_path: Path) -> None:
    wrote = [ClockAnchor(1, 2, 3, 1e-3, synchronised) for synchronised in (True, False)]
    with RecordWriter(tmp_path / "run.mcap", EPOCH_OFFSET_NS) as writer:
        for one in (*wrote, ClockAnchor(*np.arange(3), np.float64(0.5), np.int64(1))):  # type: ignore[arg-type]
            writer.write(one)
    with RecordReader(tmp_path / "run.mcap") as reader:
        assert reader.values(ClockAnchor) == [*wrote, ClockAnchor(0, 1, 2, 0.5, True)]


def test_only_flat_values_have_a_place() -> None:
    class Nested(NamedTuple):
        parts: list[int]

    with pytest.raises(TypeError, match="parts"):
        message_type_of(Nested, "/nested")


def test_nothing_is_written_after_the_end(tmp_path: Path) -> None:
    writer = RecordWriter(tmp_path / "run.mcap", 0)
    writer.close()
    writer.close()
    writer.flush()
    half_cycle = HalfCycle(0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1, 0)
    for write in (
        lambda: writer.write_event(0, "late", ""),
        lambda: writer.write_half_cycle(half_cycle),
        lambda: writer.write(Environment(5)),
    ):
        with pytest.raises(RecordError, match="closed"):
            write()


def test_the_writer_flushes_by_its_own_clock(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    now_s = [0.0]
    writer = RecordWriter(path, 0, flush_interval_s=0.8, clock=lambda: now_s[0])
    writer.write_event(1, "a", "")
    with RecordReader(path) as reader:
        assert reader.events() == []
    now_s[0] = 0.81
    writer.write_event(2, "b", "")
    with RecordReader(path) as reader:
        assert [event.kind for event in reader.events()] == ["a", "b"]
        assert reader.truncated
    writer.close()


@given(times=st.lists(st.integers(0, 10**15), min_size=1, max_size=30), texts=st.lists(st.text(), max_size=5))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_events_in_any_order_come_back(
    tmp_path_factory: pytest.TempPathFactory, times: list[int], texts: list[str]
) -> None:
    path = tmp_path_factory.mktemp("events") / "run.mcap"
    texts = [text.encode("utf-8", "replace").decode() for text in texts] or ["x"]
    with RecordWriter(path, EPOCH_OFFSET_NS, reserve_bytes=4096) as writer:
        for place, time_ns in enumerate(times):
            writer.write_event(time_ns, texts[place % len(texts)], texts[-1])
    with RecordReader(path) as reader:
        assert [event.time_ns for event in reader.events()] == times
        assert [event.kind for event in reader.events()] == [texts[i % len(texts)] for i in range(len(times))]


INFO = CameraInfo("v4l2", "Maker", "Model", "7", 640, 480, 255, has_clock=True)


WORDS = {
    "Rolling": ShutterKind.ROLLING,
    "RollingShutter": ShutterKind.ROLLING,
    "Global": ShutterKind.GLOBAL,
    "GlobalReset": ShutterKind.OTHER,
    "": ShutterKind.UNKNOWN,
}


@pytest.mark.parametrize("word", WORDS)
def test_what_is_written_is_read_as_the_same_values(word: str) -> None:
    for driver, has_clock in product(("simulated", "v4l2"), (True, False)):
        written = camera_metadata(replace(INFO, driver=driver, shutter=word, has_clock=has_clock))
        expected = RecordedCamera(driver == "simulated", has_clock, WORDS[word])
        assert RecordedCamera.from_metadata(written) == expected


def test_a_record_that_says_nothing_is_no_camera_without_a_clock() -> None:
    assert RecordedCamera.from_metadata({}) == RecordedCamera(False, None, ShutterKind.UNKNOWN)
    assert RecordedCamera.from_metadata({"camera": {"has_clock": "perhaps"}}).has_clock is None
