"""Messages of numbers are read as rows of whole chunks, whatever lies between them."""

from pathlib import Path

import numpy as np
import pytest

from acquisition.record.reader import RecordReader
from acquisition.record.topics import REFERENCE, SPOT, SWING, RecordedLosses
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RecordError
from processing.spot import Spot

EPOCH_OFFSET_NS = 10**18
FRAME_NS = 10_000_000


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
        writer._numbers.add(SPOT.topic, 0, 0, SWING.encode(*[0] * len(SWING.fields)))
    with RecordReader(path) as reader:
        for read in (reader.spots, lambda: reader.table(SPOT.topic, next(reader.unread()))):
            with pytest.raises(RecordError, match="/spot has other fields than this version writes"):
                read()
