"""Verification of a record: checksums, counts, order of times; and its recovery into a new, complete file."""

import contextlib
import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.atomic_write import atomic_file
from acquisition.record import pixels_path
from acquisition.record.digest import sha256_of, utc_text
from acquisition.record.mcap_file import McapFile
from acquisition.record.read_file import ReadFile
from acquisition.record.reader import RecordReader
from acquisition.record.topics import PIXEL_TOPICS, SPOT, WINDOW, number_topics
from processing.errors import RecordError

RECOVERY = "recovery"
"""Name of the metadata about a recovery by `rig record recover`; those of a second one are "recovery 2"."""
_RESERVE_BYTES = 1024 * 1024
FindingLevel = Literal["error", "warning", "note"]
_MAX_LISTED_GAPS = 10


class Finding(NamedTuple):
    """One result of the verification.

    An `error` means that bytes or counts differ from what was written. A `warning` means that data were lost
    during the run, as the record states. A `note` is for information.
    """

    severity: FindingLevel
    text: str


def check_record(path: Path, results: Path | None = None) -> list[Finding]:
    """Verify a whole record; an intact one gives an empty list or notes only.

    The following are checked: the file's ending; the checksums of data section, summary, chunks and
    attachments; times that decrease; gaps in the frame numbers; and the SHA-256 that `results` (a
    results.json) states for this file. Raises RecordError where either file cannot be read.
    """
    with RecordReader(path) as reader:
        findings = [finding for file in reader.files for finding in _check_file(file)]
        for name, texts in reader.metadata.items():
            if name.startswith(RECOVERY):
                lost = texts["lost"]
                text = f"recovered from {texts['source']}; lost: {lost or 'nothing'}"
                findings.append(Finding("warning" if lost else "note", text))
        findings += _check_frames(reader)
        if results is not None:
            findings += _check_hashes(reader, results)
    return findings


def _check_file(file: ReadFile) -> list[Finding]:
    """Findings on structure, chunks and attachments of one file."""
    name = file.path.name
    findings: list[Finding] = []
    if not file.is_complete:
        lost = file.size - file.readable_bytes
        where = f": {lost} bytes after the last complete entry at {utc_text(file.end_ns)}"
        if not file.end_ns:
            where = f" before anything was measured, after {file.readable_bytes} bytes"
        findings += _errors(f"{name} was cut short{where}; rig record recover makes a complete file of it")
    for chunk in file.chunks:
        file.piece(chunk)
    for attachment in file.attachments:
        list(file.copies(attachment))
    findings += _errors(*(f"{name}: {damage}" for damage in file.damages.values()))
    if not findings and not file.data_crc_matches():
        findings += _errors(f"{name}: bytes have changed outside chunks: in metadata or an index")
    return findings


def _errors(*texts: str) -> list[Finding]:
    return [Finding("error", text) for text in texts]


def _check_frames(reader: RecordReader) -> list[Finding]:
    """Findings on numbers and times of the frames, some thousand at a time."""
    gaps: list[str] = []
    backwards = first_backwards_ns = not_rising = missing = 0
    last: NDArray[Any] | None = None
    for block in reader.spot_blocks(fields=("sequence",)):
        rows = block if last is None else np.concatenate((last, block))
        last, numbers, times_ns = rows[-1:], rows["sequence"], rows["time_ns"]
        steps, decreasing = np.diff(numbers), np.flatnonzero(np.diff(times_ns) < 0)
        if len(decreasing) and not backwards:
            first_backwards_ns = int(times_ns[decreasing[0] + 1]) + reader.epoch_offset_ns
        backwards += len(decreasing)
        not_rising += int(np.count_nonzero(steps <= 0))
        missing += int((steps[steps > 1] - 1).sum())
        gaps += [f"{numbers[i] + 1}-{numbers[i + 1] - 1}" for i in np.flatnonzero(steps > 1)]
    findings: list[Finding] = []
    if backwards:
        when = utc_text(first_backwards_ns)
        findings += _errors(f"{SPOT.topic}: the time decreases {backwards} times, first at {when}")
    if not_rising:
        findings += _errors(f"{SPOT.topic}: frame numbers do not rise in {not_rising} places")
    if gaps:
        more = f" and {len(gaps) - _MAX_LISTED_GAPS} more gaps" if len(gaps) > _MAX_LISTED_GAPS else ""
        listed = f"{', '.join(gaps[:_MAX_LISTED_GAPS])}{more}"
        findings.append(Finding("warning", f"{SPOT.topic}: {missing} frames are missing: {listed}"))
    spots, windows = (reader.counts.get(topic, 0) for topic in (SPOT.topic, WINDOW.topic))
    if 0 < windows < spots:
        text = f"{WINDOW.topic}: {spots - windows} frames have a spot message and no window"
        findings.append(Finding("note", text))
    return findings


def _check_hashes(reader: RecordReader, results: Path) -> list[Finding]:
    """Compare what a results.json states of the record, its configuration and its calibrations."""
    try:
        runs = json.loads(results.read_text(encoding="utf-8"))["runs"]
        run = next((run for run in runs if Path(run["record"]).name == reader.path.name), None)
        expected = {} if run is None else {reader.path.name: run["sha256"], **run.get("inputs_sha256", {})}
    except OSError as error:
        raise RecordError(f"{results}: cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise RecordError(f"{results}: is not a results.json; name the one beside the record") from None
    if not expected:
        return [Finding("warning", f"{results.name} does not contain {reader.path.name}")]
    present = {name: hashlib.sha256(data).hexdigest() for name, data in reader.attachments.items()}
    present |= {file.path.name: sha256_of(file.path) for file in reader.files if file.path.name in expected}
    # the pixels may have been deleted since, or had no hash on a disk that could not read them
    pixels = pixels_path(reader.path).name
    if pixels not in present or not expected.get(pixels):
        expected.pop(pixels, None)
    changed = sorted(name for name, sha256 in expected.items() if present.get(name) != sha256)
    if changed:
        return _errors(*(f"{name} has another SHA-256 than {results.name} states" for name in changed))
    return [Finding("note", f"SHA-256 is the one in {results.name}: {', '.join(expected)}")]


def recover(source: Path, path: Path) -> dict[str, str]:
    """Copy every intact message of a record, its metadata and attachments into new files.

    The source is not changed. The metadata `RECOVERY` of the new record state its source and what is missing,
    and are returned; those of an earlier recovery stay. The new files appear after they were read back and
    checked. Raises RecordError where the source is no record of this program, or the new file exists already
    or cannot be written.
    """
    pixels = pixels_path(path)
    try:
        with contextlib.ExitStack() as stack:
            reader = stack.enter_context(RecordReader(source))
            names = [stack.enter_context(atomic_file(name)) for name in (path, pixels)[: len(reader.files)]]
            counts: Counter[str] = Counter()
            copies: list[McapFile] = []
            topics = (number_topics(reader.deflection_unit), PIXEL_TOPICS)
            for file, name, file_topics in zip(reader.files, names, topics, strict=False):
                copy = McapFile(name, file_topics, _RESERVE_BYTES)
                # Windows removes only closed files
                stack.callback(copy.abandon)
                counts += _copy_messages(file, copy)
                copies.append(copy)
            recovery = _copy_metadata(reader, copies)
            for copy in copies:
                copy.finish()
                if copy.disk.full is not None:
                    raise copy.disk.full
            _verify(names, counts, path, source)
    except FileExistsError as error:
        raise RecordError(
            f"{error.filename}: exists already and is never overwritten; choose another name"
        ) from None
    except OSError as error:
        reason = error.strerror or error
        raise RecordError(f"{path}: cannot be written: {reason}; {source} is unchanged") from error
    return recovery


def _copy_messages(file: ReadFile, copy: McapFile) -> Counter[str]:
    """Copy all intact messages; returns how many, by topic."""
    counts: Counter[str] = Counter()
    for chunk in file.chunks:
        for message in file.piece(chunk).messages():
            copy.add(*message)
            counts[message.topic] += 1
        if copy.disk.full is not None:
            raise copy.disk.full
    return counts


def _copy_metadata(reader: RecordReader, copies: Sequence[McapFile]) -> dict[str, str]:
    """Copy attachments and metadata; returns those about the recovery."""
    start_ns = reader.numbers.start_ns
    for name, data in reader.attachments.items():
        copies[0].add_attachment(name, "application/octet-stream", data, start_ns)
    lost = reader.damages
    for file in reader.files:
        if not file.is_complete and (rest := file.size - file.readable_bytes):
            lost.append(f"{rest} bytes after the last complete entry of {file.path.name}")
    source_sha256 = ""
    with contextlib.suppress(RecordError):
        # empty if the disk cannot read all of the source
        source_sha256 = sha256_of(reader.path)
    recovery = {
        "source": reader.path.name,
        "source_sha256": source_sha256,
        "source_was_cut": str(reader.truncated).lower(),
        "lost": "; ".join(lost),
    }
    earlier = sum(name.startswith(RECOVERY) for name in reader.metadata)
    name = f"{RECOVERY} {earlier + 1}" if earlier else RECOVERY
    numbers, pixels = {**reader.metadata, name: recovery}, {"record": reader.metadata["record"]}
    for copy, metadata in zip(copies, (numbers, pixels), strict=False):
        copy.add_metadata(metadata, start_ns)
    return recovery


def _verify(names: Sequence[Path], counts: Mapping[str, int], path: Path, source: Path) -> None:
    """Read the copies again. Raises RecordError where they do not hold what was written."""
    counts_read: Counter[str] = Counter()
    sound = True
    for name in names:
        with contextlib.closing(ReadFile(name)) as copy:
            sound = sound and copy.is_sound()
            counts_read.update({topic: copy.counts[number] for number, topic in copy.channels.items()})
    if not sound or +counts_read != Counter(counts):
        raise RecordError(f"{path}: does not hold what was written; {source} is unchanged")
