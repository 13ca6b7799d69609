"""Verification of a record: checksums, counts, and order of times."""

import hashlib
import json
import struct
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Literal, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from acquisition.record.chunk_reader import ChunkDamage, ChunkPlace, message_heads
from acquisition.record.contents import Contents, walk
from acquisition.record.frame_numbers import MOST_SHOWN, FrameNumbers
from acquisition.record.proof import RECOVERY, THINNED, data_crc_matches, measured_sha256_of, unproved_parts
from acquisition.record.reader import RecordReader
from acquisition.record.records import intact_attachment, read_record
from acquisition.record.schemas import parse_message_type
from acquisition.record.topics import PACKAGE, SPOT, WINDOW
from acquisition.record.utc import utc_text
from processing.errors import RecordError

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
    """Counts, times and frame numbers of the messages themselves, accumulated chunk by chunk.

    `frames` are by channel, of those channels that are `followed`.
    """

    followed: frozenset[int]
    counts: Counter[int] = field(default_factory=Counter)
    last_ns: dict[int, int] = field(default_factory=dict)
    backwards: Counter[int] = field(default_factory=Counter)
    first_backwards_ns: dict[int, int] = field(default_factory=dict)
    frames: dict[int, FrameNumbers] = field(default_factory=lambda: defaultdict(FrameNumbers))

    def add(self, channel: int, heads: NDArray[np.void]) -> None:
        """The messages of one channel in the next chunk."""
        times_ns = heads["log_time_ns"]
        before_ns = np.roll(times_ns, 1)
        before_ns[0] = self.last_ns.get(channel, int(times_ns[0]))
        back = times_ns < before_ns
        if back.any():
            self.backwards[channel] += int(np.count_nonzero(back))
            self.first_backwards_ns.setdefault(channel, int(times_ns[back][0]))
        self.counts[channel] += len(heads)
        self.last_ns[channel] = int(times_ns[-1])
        if channel in self.followed:
            self.frames[channel].add(heads["sequence"].astype(np.int64))


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
        findings = _errors(*(f"index: {text}" for text in contents.damage))
        if reader.truncated:
            lost = contents.size - contents.readable_bytes
            where = f": {lost} bytes after the last complete record at {utc_text(contents.end_ns)}"
            if not contents.end_ns:
                where = f" before anything was measured, after {contents.readable_bytes} bytes"
            findings += _errors(f"the file was cut short{where}; rig recover makes a complete file of it")
        tally = _Tally(_followed(contents))
        findings += _check_chunks(reader, tally)
        findings += _check_attachments(reader)
        findings += _check_index(reader.file, contents)
        if reader.disk_notice:
            findings += _errors(reader.disk_notice)
        bytes_changed = not data_crc_matches(reader.file, contents)
        if bytes_changed and not any(finding.severity == "error" for finding in findings):
            findings += _errors("bytes have changed outside chunks: in metadata or a description")
        if reader.truncated or bytes_changed:
            findings += [
                Finding("warning", f"{part}: nothing in the file proves it")
                for part in unproved_parts(reader.file, contents)
            ]
        findings += [
            _check_recovery(texts) for name, texts in reader.metadata.items() if name.startswith(RECOVERY)
        ]
        findings += [
            Finding(
                "note",
                f"thinned {texts.get('utc', '')[:10]}: {texts.get('window_count', '?')} windows "
                f"{texts.get('windows', '?')}; measured as SHA-256 {texts.get('measured_sha256', '?')}",
            )
            for name, texts in reader.metadata.items()
            if name.startswith(THINNED)
        ]
        findings += _check_types(contents)
        findings += _check_counts(contents, tally)
        findings += _check_order(contents, tally)
        findings += _check_sequences(contents, tally)
        if results is not None:
            findings += _check_hashes(reader, results)
    return findings


def _errors(*texts: str) -> list[Finding]:
    return [Finding("error", text) for text in texts]


def _followed(contents: Contents) -> frozenset[int]:
    return frozenset(n for n, c in contents.channels.items() if c.topic in (SPOT.topic, WINDOW.topic))


def _check_chunks(reader: RecordReader, tally: _Tally) -> list[Finding]:
    contents = reader.contents
    findings: list[Finding] = []
    opened = reader.chunk_opener()
    for place in contents.chunks:

        def found(what: str, place: ChunkPlace = place) -> None:
            span = f"{utc_text(place.start_ns)} to {utc_text(place.end_ns)}"
            topics = sorted(contents.channels[n].topic for n in place.channels if n in contents.channels)
            where = f"chunk at byte {place.offset} ({' '.join(topics) or 'topics unknown'}, {span})"
            findings.extend(_errors(f"{where}: {what}"))

        try:
            chunk = opened(place)
            places, heads = message_heads(chunk)
        except ChunkDamage as damage:
            found(str(damage))
            continue
        expected: dict[int, bytes] = {}
        for channel in dict.fromkeys(heads["channel"].tolist()):
            of_channel = heads["channel"] == channel
            tally.add(channel, heads[of_channel])
            entries = np.empty((np.count_nonzero(of_channel), 2), dtype="<u8")
            entries[:, 0], entries[:, 1] = heads["log_time_ns"][of_channel], places[of_channel]
            expected[channel] = entries.tobytes()
        times_ns = heads["log_time_ns"]
        stated = {(chunk.start_ns, chunk.end_ns), (place.start_ns, place.end_ns)}
        if len(times_ns) and stated != {(int(times_ns.min()), int(times_ns.max()))}:
            found("the times in its header differ from its messages")
        if not _index_matches(reader.file, contents, place, expected):
            found("its message index does not match its messages")
    return findings


def _index_matches(
    file: IO[bytes], contents: Contents, place: ChunkPlace, expected: Mapping[int, bytes]
) -> bool:
    """Whether the message index after a chunk agrees with its messages; a truncated file may lack it.

    `expected` holds each channel's (log time, offset) pairs as they are encoded in the index.
    """
    at = place.offset + place.length
    for _ in expected:
        try:
            opcode, data = read_record(file, at)
            channel, size = struct.unpack_from("<HI", data)
        except (ValueError, struct.error):
            return not contents.whole and at >= contents.readable_bytes
        if opcode != Opcode.MESSAGE_INDEX or data[6 : 6 + size] != expected.get(channel):
            return False
        at += 9 + len(data)
    return True


_MISSING = (
    "lost_chunks",
    "lost_bytes_at_the_end",
    "lost_parts",
    "doubles_left_out",
    "foreign_left_out",
    "chunks_moved",
    "unproved",
)


def _check_recovery(recovery: Mapping[str, str]) -> Finding:
    """What the record lacked from which this one was made: sound bytes may hold what was changed before."""
    missing = [
        f"{name.replace('_', ' ')}: {recovery[name]}"
        for name in _MISSING
        if recovery.get(name, "0") not in ("0", "")
    ]
    text = f"recovered from {recovery.get('source', '?')}; {'; '.join(missing) or 'nothing was lost'}"
    return Finding("warning" if missing else "note", text)


def _check_attachments(reader: RecordReader) -> list[Finding]:
    findings: list[Finding] = []
    for name, places in reader.contents.attachment_places.items():
        for place in places:
            try:
                intact_attachment(read_record(reader.file, place)[1])
            except ValueError as error:
                findings += _errors(f"attachment {name}: {error}")
    return findings


def _check_index(file: IO[bytes], contents: Contents) -> list[Finding]:
    """Compare the summary with the data section, read from record to record."""
    if not contents.whole or contents.statistics is None:
        return []
    walked = Contents(contents.size)
    walk(file, walked)
    listed, found = (np.unique(each.chunks.extents(), axis=0) for each in (contents, walked))
    if walked.data_end == contents.data_end and np.array_equal(listed, found) and not walked.damage:
        return []
    what = "; ".join(walked.damage) or "a length or kind has changed"
    return _errors(f"the records of the data section cannot be followed: {what}")


def _check_types(contents: Contents) -> list[Finding]:
    findings: list[Finding] = []
    for channel in contents.channels.values():
        schema = contents.schemas.get(channel.schema_id)
        if schema is None:
            findings += _errors(f"{channel.topic}: its description is missing")
        elif schema.name.startswith(f"{PACKAGE}."):
            try:
                parse_message_type(schema.name, channel.topic, schema.data)
            except ValueError as error:
                findings += _errors(f"{channel.topic}: {error}")
    return findings


def _check_counts(contents: Contents, tally: _Tally) -> list[Finding]:
    return _errors(
        *(
            f"{channel.topic}: {tally.counts[number]} messages can be read, "
            f"the index states {contents.counts[number]}"
            for number, channel in contents.channels.items()
            if contents.whole and tally.counts[number] != contents.counts[number]
        )
    )


def _check_order(contents: Contents, tally: _Tally) -> list[Finding]:
    return _errors(
        *(
            f"{contents.channels[number].topic}: the time decreases {count} times, first at "
            f"{utc_text(tally.first_backwards_ns[number])}"
            for number, count in sorted(tally.backwards.items())
            if number in tally.followed
        )
    )


def _check_sequences(contents: Contents, tally: _Tally) -> list[Finding]:
    numbers = {channel.topic: number for number, channel in contents.channels.items()}
    spots, windows = (
        tally.frames.get(numbers.get(topic, -1), FrameNumbers()) for topic in (SPOT.topic, WINDOW.topic)
    )
    findings: list[Finding] = []
    if spots.not_rising:
        findings += _errors(f"{SPOT.topic}: frame numbers do not rise in {spots.not_rising} places")
    if spots.gaps:
        shown = ", ".join(f"{first}-{last}" for first, last in spots.first_gaps)
        more = f" and {spots.gaps - len(spots.first_gaps)} more gaps" if spots.gaps > MOST_SHOWN else ""
        text = f"{SPOT.topic}: {spots.missing} frames are missing: {shown}{more}"
        findings.append(Finding("warning", text))
    strange, first = windows.not_in(spots)
    if strange:
        text = f"{WINDOW.topic}: {strange} windows have no spot, first frame {first}"
        findings.append(Finding("warning", text))
    if 0 < windows.count < spots.count:
        text = f"{WINDOW.topic}: {spots.count - windows.count} frames have a spot message and no window"
        findings.append(Finding("note", text))
    return findings


def _check_hashes(reader: RecordReader, results: Path) -> list[Finding]:
    """Compare what a results.json states of the record, its configuration and its calibrations."""
    try:
        tree = json.loads(results.read_text(encoding="utf-8"))
        stated = {Path(run["record"]).name: run for run in tree["runs"]}
        run = stated.get(reader.path.name)
        sha256, inputs = ("", {}) if run is None else (run["sha256"], dict(run.get("inputs_sha256", {})))
    except OSError as error:
        raise RecordError(f"{results}: cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise RecordError(f"{results}: is not a results.json; name the one beside the record") from None
    if run is None:
        return [Finding("warning", f"{results.name} does not contain {reader.path.name}")]
    if sha256 != measured_sha256_of(reader.path):
        return _errors(f"SHA-256 is not the one in {results.name}: the record is not the one that was fitted")
    held = {name: hashlib.sha256(data).hexdigest() for name, data in reader.attachments.items()}
    others = sorted(name for name, value in inputs.items() if held.get(name) != value)
    if others:
        return _errors(
            *(f"{results.name} states another SHA-256 of {name} than the record's" for name in others)
        )
    more = f", also of {', '.join(sorted(inputs))}" if inputs else ""
    return [Finding("note", f"SHA-256 is the one in {results.name}{more}")]
