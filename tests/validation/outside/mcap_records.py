"""Records held against the MCAP format: read by the reader of the mcap package, not by ours.

The writer stands on the package's own, above a stream that cuts failed writes off (decision 37); our reader
skips what is damaged; the package's checks every sum and believes no index.
"""

import struct
import tempfile
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from acquisition.record.read_file import ReadFile
from tests.acquisition.record.samples import write_sample
from tests.rig.view.replay_record import make_record
from tests.validation.row import Found

MAGIC = b"\x89MCAP0\r\n"


def faults(path: Path) -> tuple[list[str], int]:
    """What is wrong with one file, and the number of its messages."""
    try:
        return _faults(path)
    # whatever makes another reader give up
    except Exception as error:
        return [f"{type(error).__name__}: {error}"], 0


def _faults(path: Path) -> tuple[list[str], int]:
    """What the package's reader and the specification's rules find wrong in one file, and its messages."""
    wrong = []
    with path.open("rb") as file:
        data = file.read()
    if not (data.startswith(MAGIC) and data.endswith(MAGIC)):
        wrong.append("no magic at an end")
    seen: Counter[int] = Counter()
    times = []
    with path.open("rb") as file:
        record: Any
        for record in StreamReader(file, validate_crcs=True).records:
            if type(record).__name__ == "Message":
                seen[record.channel_id] += 1
                times.append(record.log_time)
    with path.open("rb") as file:
        reader: Any = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        stated = summary.statistics
        indexed: Counter[int] = Counter(channel.id for _, channel, _ in reader.iter_messages())
    if stated is None:
        return [*wrong, "no statistics"], len(times)
    if dict(stated.channel_message_counts) != dict(seen) or stated.message_count != len(times):
        wrong.append("statistics count other messages than there are")
    if indexed != seen:
        wrong.append("the index leads to other messages than there are")
    if times and (stated.message_start_time, stated.message_end_time) != (min(times), max(times)):
        wrong.append("statistics state other times")
    if stated.chunk_count != len(summary.chunk_indexes):
        wrong.append("statistics count other chunks")
    wrong += [f"chunk at {i.chunk_start_offset}" for i in summary.chunk_indexes if not _is_chunk(data, i)]
    if not set(seen) <= set(summary.channels):
        wrong.append("a channel without a description")
    if any(c.schema_id and c.schema_id not in summary.schemas for c in summary.channels.values()):
        wrong.append("a channel without its schema")
    ours = ReadFile(path)
    ours.close()
    if ours.counts.total() != len(times):
        wrong.append("our reader sees another number of messages")
    return wrong, len(times)


def _is_chunk(data: bytes, index: Any) -> bool:
    """Whether an index leads to a chunk of the length that it states."""
    opcode, length = struct.unpack_from("<BQ", data, index.chunk_start_offset)
    return bool(opcode == Opcode.CHUNK and length + 9 == index.chunk_length)


@cache
def conformance() -> dict[str, Found]:
    """Faults over records of 8 and 16 bit."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_sample(folder / "sixteen.mcap", 128, dtype="u2")
        write_sample(folder / "eight.mcap", 128)
        make_record(folder / "run-1.mcap", 30.0)
        results = {path.name: faults(path) for path in folder.glob("*.mcap")}
    named = [f"{name}: {fault}" for name, (found, _) in results.items() for fault in found]
    messages = sum(count for _, count in results.values())
    detail = "; ".join(named) or f"{len(results)} records, {messages:,} messages"
    return {"faults": Found((float(len(named)),), detail)}
