"""Verification of a record: checksums, counts, and order of times."""

import json
import struct
import zlib
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Literal, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from acquisition.record.chunk_reader import ChunkDamage, RawMessage, messages_in, open_chunk
from acquisition.record.contents import ChunkPlace, Contents, parse, read_record, walk
from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from acquisition.record.schemas import parse_message_type
from acquisition.record.topics import PACKAGE, SPOT, WINDOW
from acquisition.record.utc import utc_text
from processing.errors import RecordError

_BLOCK_BYTES = 4 * 1024 * 1024
_MOST_SHOWN = 10
Severity = Literal["error", "warning", "note"]


class Finding(NamedTuple):
    """One result of the verification.

    An `error` means that bytes or counts differ from what was written. A `warning` means that data were lost
    during the run, as the record states. A `note` is for information.
    """

    severity: Severity
    text: str


@dataclass
class _Tally:
    """Counts and times from the messages themselves, accumulated chunk by chunk."""

    counts: Counter[int] = field(default_factory=Counter)
    last_ns: dict[int, int] = field(default_factory=dict)
    backwards: Counter[int] = field(default_factory=Counter)
    first_backwards_ns: dict[int, int] = field(default_factory=dict)
    sequences: dict[int, list[np.ndarray[tuple[int], np.dtype[np.int64]]]] = field(
        default_factory=lambda: defaultdict(list)
    )

    def add(self, messages: list[RawMessage], followed: frozenset[int]) -> None:
        by_channel: dict[int, list[int]] = defaultdict(list)
        for message in messages:
            self.counts[message.channel] += 1
            last_ns = self.last_ns.get(message.channel, message.log_time_ns)
            if message.log_time_ns < last_ns:
                self.backwards[message.channel] += 1
                self.first_backwards_ns.setdefault(message.channel, message.log_time_ns)
            self.last_ns[message.channel] = message.log_time_ns
            if message.channel in followed:
                by_channel[message.channel].append(message.sequence)
        for channel, sequences in by_channel.items():
            self.sequences[channel].append(np.array(sequences, dtype=np.int64))


def check_record(path: Path, results: Path | None = None) -> list[Finding]:
    """Verify a whole record; an intact one gives an empty list or notes only.

    The following are checked: the file's ending; the checksums of data section, summary, chunks and
    attachments; the indexes and times of chunks; counts; message types; times that decrease; gaps in the
    frame numbers; windows of frames without a spot; and the SHA-256 that `results` (a results.json) states
    for this file.

    Raises
    ------
    RecordError
        The file is not a record of this program, or `results` cannot be read.
    """
    with RecordReader(path) as reader:
        contents = reader.contents
        findings = [Finding("error", f"index: {text}") for text in contents.damage]
        if reader.truncated:
            lost = contents.size - contents.readable_bytes
            findings.append(
                Finding(
                    "error",
                    f"the file was cut short: {lost} bytes after the last complete record at "
                    f"{utc_text(contents.end_ns)}; rig recover makes a complete file of it",
                )
            )
        tally = _Tally()
        findings += _check_chunks(reader, tally)
        findings += _check_attachments(reader)
        findings += _check_index(reader.file, contents)
        bytes_changed = not _data_crc_matches(reader.file, contents)
        if bytes_changed and not any(finding.severity == "error" for finding in findings):
            findings.append(
                Finding("error", "bytes have changed outside chunks: in metadata or a description")
            )
        findings += _check_types(contents)
        findings += _check_counts(contents, tally)
        findings += _check_order(contents, tally)
        findings += _check_sequences(contents, tally)
    if results is not None:
        findings.append(_check_hash(path, results))
    return findings


def _check_chunks(reader: RecordReader, tally: _Tally) -> list[Finding]:
    contents = reader.contents
    followed = frozenset(n for n, c in contents.channels.items() if c.topic in (SPOT.topic, WINDOW.topic))
    findings = []
    for place in contents.chunks:
        span = f"{utc_text(place.start_ns)} to {utc_text(place.end_ns)}"
        where = f"chunk at byte {place.offset} ({_topics(contents, place)}, {span})"
        try:
            chunk = open_chunk(reader.file, place)
            messages = list(messages_in(chunk.data))
        except ChunkDamage as damage:
            findings.append(Finding("error", f"{where}: {damage}"))
            continue
        tally.add(messages, followed)
        times = [message.log_time_ns for message in messages]
        stated = {(chunk.start_ns, chunk.end_ns), (place.start_ns, place.end_ns)}
        if times and stated != {(min(times), max(times))}:
            findings.append(Finding("error", f"{where}: the times in its header differ from its messages"))
        if not _index_matches(reader.file, contents, place, messages):
            findings.append(Finding("error", f"{where}: its message index does not match its messages"))
    return findings


def _index_matches(
    file: IO[bytes], contents: Contents, place: ChunkPlace, messages: list[RawMessage]
) -> bool:
    """Whether the message index after a chunk agrees with its messages; a truncated file may lack it."""
    expected: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for message in messages:
        expected[message.channel].append((message.log_time_ns, message.offset))
    at = place.offset + place.length
    for _ in range(len(expected)):
        try:
            opcode, data = read_record(file, at)
            channel, size = struct.unpack_from("<HI", data)
            entries = list(struct.iter_unpack("<QQ", data[6 : 6 + size]))
        except (ValueError, struct.error):
            return not contents.whole and at >= contents.readable_bytes
        if opcode != Opcode.MESSAGE_INDEX or entries != expected.get(channel):
            return False
        at += 9 + len(data)
    return True


def _check_attachments(reader: RecordReader) -> list[Finding]:
    findings = []
    for name, place in reader.contents.attachment_places.items():
        try:
            opcode, data = read_record(reader.file, place)
            parse(opcode, data)
            intact = zlib.crc32(data[:-4]) == struct.unpack("<I", data[-4:])[0] or not any(data[-4:])
        except (ValueError, struct.error):
            intact = False
        if not intact:
            findings.append(
                Finding("error", f"attachment {name}: its checksum does not match: bytes have changed")
            )
    return findings


def _check_index(file: IO[bytes], contents: Contents) -> list[Finding]:
    """Compare the summary with the data section, read from record to record."""
    if not contents.whole or contents.statistics is None:
        return []
    walked = Contents(contents.size)
    walk(file, walked)
    listed = {(chunk.offset, chunk.length) for chunk in contents.chunks}
    found = {(chunk.offset, chunk.length) for chunk in walked.chunks}
    if walked.data_end == contents.data_end and listed == found and not walked.damage:
        return []
    return [
        Finding(
            "error",
            f"the records of the data section cannot be followed from byte {walked.readable_bytes} on: "
            "a length or kind has changed",
        )
    ]


def _data_crc_matches(file: IO[bytes], contents: Contents) -> bool:
    if not contents.whole or contents.data_crc == 0:
        return True
    crc, rest = 0, contents.data_end
    file.seek(0)
    while rest > 0:
        block = file.read(min(_BLOCK_BYTES, rest))
        if not block:
            return False
        crc = zlib.crc32(block, crc)
        rest -= len(block)
    return crc == contents.data_crc


def _check_types(contents: Contents) -> list[Finding]:
    findings = []
    for channel in contents.channels.values():
        schema = contents.schemas.get(channel.schema_id)
        if schema is None:
            findings.append(Finding("error", f"{channel.topic}: its description is missing"))
        elif schema.name.startswith(f"{PACKAGE}."):
            try:
                parse_message_type(schema.name, channel.topic, schema.data)
            except ValueError as error:
                findings.append(Finding("error", f"{channel.topic}: {error}"))
    return findings


def _check_counts(contents: Contents, tally: _Tally) -> list[Finding]:
    return [
        Finding(
            "error",
            f"{channel.topic}: {tally.counts[number]} messages can be read, "
            f"the index states {contents.counts[number]}",
        )
        for number, channel in contents.channels.items()
        if contents.whole and tally.counts[number] != contents.counts[number]
    ]


def _check_order(contents: Contents, tally: _Tally) -> list[Finding]:
    return [
        Finding(
            "error",
            f"{contents.channels[number].topic}: the time decreases {count} times, first at "
            f"{utc_text(tally.first_backwards_ns[number])}",
        )
        for number, count in sorted(tally.backwards.items())
        if number in contents.channels and contents.channels[number].topic in (SPOT.topic, WINDOW.topic)
    ]


def _check_sequences(contents: Contents, tally: _Tally) -> list[Finding]:
    numbers = {channel.topic: number for number, channel in contents.channels.items()}
    findings = []
    spots = _joined(tally, numbers.get(SPOT.topic))
    steps = np.diff(spots)
    if (steps <= 0).any():
        findings.append(
            Finding("error", f"{SPOT.topic}: frame numbers do not rise in {int((steps <= 0).sum())} places")
        )
    gaps = np.flatnonzero(steps > 1)
    if len(gaps):
        shown = ", ".join(f"{spots[i] + 1}-{spots[i + 1] - 1}" for i in gaps[:_MOST_SHOWN])
        more = f" and {len(gaps) - _MOST_SHOWN} more gaps" if len(gaps) > _MOST_SHOWN else ""
        missing = int((steps[gaps] - 1).sum())
        findings.append(Finding("warning", f"{SPOT.topic}: {missing} frames are missing: {shown}{more}"))
    windows = _joined(tally, numbers.get(WINDOW.topic))
    strange = np.setdiff1d(windows, spots)
    if len(strange):
        findings.append(
            Finding(
                "warning",
                f"{WINDOW.topic}: {len(strange)} windows have no spot, first frame {strange[0]}",
            )
        )
    if len(windows) and len(windows) < len(spots):
        findings.append(
            Finding(
                "note",
                f"{WINDOW.topic}: {len(spots) - len(windows)} frames have a spot message and no window",
            )
        )
    return findings


def _joined(tally: _Tally, channel: int | None) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    parts = tally.sequences.get(channel, []) if channel is not None else []
    return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)


def _check_hash(path: Path, results: Path) -> Finding:
    try:
        tree = json.loads(results.read_text(encoding="utf-8"))
        stated = {Path(run["record"]).name: str(run["sha256"]) for run in tree["runs"]}
    except OSError as error:
        raise RecordError(f"{results}: cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError):
        raise RecordError(f"{results}: is not a results.json; name the one beside the record") from None
    if path.name not in stated:
        return Finding("warning", f"{results.name} does not contain {path.name}")
    if stated[path.name] != sha256_of(path):
        return Finding(
            "error", f"SHA-256 is not the one in {results.name}: the record is not the one that was fitted"
        )
    return Finding("note", f"SHA-256 is the one in {results.name}")


def _topics(contents: Contents, place: ChunkPlace) -> str:
    names = sorted(contents.channels[n].topic for n in place.channels if n in contents.channels)
    return " ".join(names) or "topics unknown"
