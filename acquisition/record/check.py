"""Verification of a record: checksums, counts, and order of times."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.record import pixels_beside
from acquisition.record.chunk import ChunkDamage, message_heads
from acquisition.record.digest import sha256_of, utc_text
from acquisition.record.read_file import ReadFile
from acquisition.record.reader import RecordReader
from acquisition.record.recover import RECOVERY
from acquisition.record.topics import SPOT, WINDOW
from processing.errors import RecordError

FindingLevel = Literal["error", "warning", "note"]
_MAX_SHOWN_GAPS = 10


class Finding(NamedTuple):
    """One result of the verification.

    An `error` means that bytes or counts differ from what was written. A `warning` means that data were lost
    during the run, as the record states. A `note` is for information.
    """

    severity: FindingLevel
    text: str


@dataclass
class _FrameTally:
    """Numbers and times of the frames of one topic, accumulated chunk by chunk.

    `not_rising` is how often a number was not larger than the one before, `backwards` how often a time was
    smaller, `gaps` how often a number was larger by more than one, `missing` how many frames are missing.
    `first_gaps` are the first and last missing number of each of the first ten gaps.
    """

    count: int = 0
    not_rising: int = 0
    backwards: int = 0
    first_backwards_ns: int = 0
    gaps: int = 0
    missing: int = 0
    first_gaps: list[tuple[int, int]] = field(default_factory=list)
    _last: tuple[int, int] | None = None

    def add(self, heads: NDArray[np.void]) -> None:
        """Add the frames (at least one) of a chunk."""
        numbers, times_ns = heads["sequence"].astype(np.int64), heads["log_time_ns"]
        last, last_ns = self._last or (int(numbers[0]) - 1, int(times_ns[0]))
        earlier = np.concatenate(([last], numbers[:-1]))
        back = np.flatnonzero(times_ns < np.concatenate((np.array([last_ns], np.uint64), times_ns[:-1])))
        if len(back) and not self.backwards:
            self.first_backwards_ns = int(times_ns[back[0]])
        gaps = np.flatnonzero(numbers - earlier > 1)
        for at in gaps[: _MAX_SHOWN_GAPS - len(self.first_gaps)]:
            self.first_gaps.append((int(earlier[at]) + 1, int(numbers[at]) - 1))
        self.count += len(numbers)
        self.backwards += len(back)
        self.not_rising += int(np.count_nonzero(numbers <= earlier))
        self.gaps += len(gaps)
        self.missing += int((numbers - earlier - 1)[gaps].sum())
        self._last = int(numbers[-1]), int(times_ns[-1])


def check_record(path: Path, results: Path | None = None) -> list[Finding]:
    """Verify a whole record; an intact one gives an empty list or notes only.

    The following are checked: the file's ending; the checksums of data section, summary, chunks and
    attachments; times that decrease; gaps in the frame numbers; and the SHA-256 that `results` (a
    results.json) states for this file.

    Raises
    ------
    RecordError
        The file is not a record of this program, or `results` cannot be read.
    """
    with RecordReader(path) as reader:
        frames = {SPOT.topic: _FrameTally(), WINDOW.topic: _FrameTally()}
        findings = [finding for file in reader.files for finding in _check_file(file, frames)]
        findings += [
            _check_recovery(texts) for name, texts in reader.metadata.items() if name.startswith(RECOVERY)
        ]
        findings += _check_frames(frames)
        if results is not None:
            findings += _check_hashes(reader, results)
    return findings


def _check_file(file: ReadFile, frames: Mapping[str, _FrameTally]) -> list[Finding]:
    """Findings on structure, chunks and attachments of one file; its frames are added to `frames`."""
    contents, name = file.contents, file.path.name
    findings = _errors(*(f"{name}: index: {text}" for text in contents.damage))
    if not contents.whole:
        lost = contents.size - contents.readable_bytes
        where = f": {lost} bytes after the last complete entry at {utc_text(contents.end_ns)}"
        if not contents.end_ns:
            where = f" before anything was measured, after {contents.readable_bytes} bytes"
        findings += _errors(f"{name} was cut short{where}; rig record recover makes a complete file of it")
    findings += _check_chunks(file, frames)
    for attached, places in contents.attachment_places.items():
        for place in places:
            try:
                file.attachment_at(place)
            except ValueError as error:
                findings += _errors(f"{name}: attachment {attached}: {error}")
    if not findings and not file.data_crc_matches():
        findings += _errors(f"{name}: bytes have changed outside chunks: in metadata or an index")
    return findings


def _errors(*texts: str) -> list[Finding]:
    return [Finding("error", text) for text in texts]


def _check_chunks(file: ReadFile, frames: Mapping[str, _FrameTally]) -> list[Finding]:
    channels = file.contents.channels
    findings: list[Finding] = []
    for place in file.contents.chunks:
        try:
            heads = message_heads(file.open_chunk(place))
        except ChunkDamage as damage:
            span = f"{utc_text(place.start_ns)} to {utc_text(place.end_ns)}"
            topics = " ".join(sorted(channels[n] for n in place.channels)) or "topics unknown"
            findings += _errors(
                f"{file.path.name}: chunk at byte {place.offset} ({topics}, {span}): {damage}"
            )
            continue
        for number, topic in channels.items():
            channel_heads = heads[heads["channel"] == number]
            if topic in frames and len(channel_heads):
                frames[topic].add(channel_heads)
    return findings


_LOSS_KEYS = ("lost_chunks", "lost_bytes_at_the_end", "lost_parts")


def _check_recovery(recovery: Mapping[str, str]) -> Finding:
    """Report what was missing in the damaged record that this one was recovered from."""
    missing = [
        f"{name.replace('_', ' ')}: {recovery[name]}"
        for name in _LOSS_KEYS
        if recovery.get(name, "0") not in ("0", "")
    ]
    text = f"recovered from {recovery.get('source', '?')}; {'; '.join(missing) or 'nothing was lost'}"
    return Finding("warning" if missing else "note", text)


def _check_frames(frames: Mapping[str, _FrameTally]) -> list[Finding]:
    findings = _errors(
        *(
            f"{topic}: the time decreases {tally.backwards} times, first at "
            f"{utc_text(tally.first_backwards_ns)}"
            for topic, tally in frames.items()
            if tally.backwards
        )
    )
    spots, windows = frames[SPOT.topic], frames[WINDOW.topic]
    if spots.not_rising:
        findings += _errors(f"{SPOT.topic}: frame numbers do not rise in {spots.not_rising} places")
    if spots.gaps:
        shown = ", ".join(f"{first}-{last}" for first, last in spots.first_gaps)
        more = f" and {spots.gaps - len(spots.first_gaps)} more gaps" if spots.gaps > _MAX_SHOWN_GAPS else ""
        text = f"{SPOT.topic}: {spots.missing} frames are missing: {shown}{more}"
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
    if sha256 != sha256_of(reader.path):
        return _errors(f"SHA-256 is not the one in {results.name}: the record is not the one that was fitted")
    pixels = pixels_beside(reader.path)
    pixels_sha256 = inputs.get(pixels.name, "")
    if pixels_sha256 and pixels.is_file() and pixels_sha256 != sha256_of(pixels):
        return _errors(f"{pixels.name}: its SHA-256 is not the one in {results.name}")
    attachment_sha256 = {name: hashlib.sha256(data).hexdigest() for name, data in reader.attachments.items()}
    changed = sorted(
        name for name, value in inputs.items() if name != pixels.name and attachment_sha256.get(name) != value
    )
    if changed:
        return _errors(
            *(f"{results.name} states another SHA-256 of {name} than the record's" for name in changed)
        )
    more = f", also of {', '.join(sorted(inputs))}" if inputs else ""
    return [Finding("note", f"SHA-256 is the one in {results.name}{more}")]
