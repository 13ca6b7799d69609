"""Verification of a record: checksums, counts, and order of times."""

import hashlib
import json
from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.record import pixels_beside
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
        frames = {SPOT.topic: array("Q"), WINDOW.topic: array("Q")}
        findings = [finding for file in reader.files for finding in _check_file(file, frames)]
        findings += [
            _check_recovery(texts) for name, texts in reader.metadata.items() if name.startswith(RECOVERY)
        ]
        findings += _check_frames(
            *(np.array(values, np.int64).reshape(-1, 2).T for values in frames.values())
        )
        if results is not None:
            findings += _check_hashes(reader, results)
    return findings


def _check_file(file: ReadFile, frames: Mapping[str, "array[int]"]) -> list[Finding]:
    """Findings on structure, chunks and attachments of one file.

    Number and time (UTC) of its frames are appended to `frames`, by topic.
    """
    name = file.path.name
    findings = _errors(*(f"{name}: index: {text}" for text in file.damage))
    if not file.whole:
        lost = file.size - file.readable_bytes
        where = f": {lost} bytes after the last complete entry at {utc_text(file.end_ns)}"
        if not file.end_ns:
            where = f" before anything was measured, after {file.readable_bytes} bytes"
        findings += _errors(f"{name} was cut short{where}; rig record recover makes a complete file of it")
    for place in file.chunks:
        for message in file.messages(place):
            if message.topic in frames:
                frames[message.topic].extend((message.sequence, message.log_time_ns))
    for attached in file.attachments:
        list(file.copies(attached))
    for offset, damage in file.damages.items():
        span = f"{utc_text(damage.start_ns)} to {utc_text(damage.end_ns)}"
        chunk = f"chunk at byte {offset} ({' '.join(damage.topics) or 'topics unknown'}, {span}): "
        findings += _errors(f"{name}: {chunk if damage.start_ns else ''}{damage.description}")
    if not findings and not file.data_crc_matches():
        findings += _errors(f"{name}: bytes have changed outside chunks: in metadata or an index")
    return findings


def _errors(*texts: str) -> list[Finding]:
    return [Finding("error", text) for text in texts]


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


def _check_frames(spots: NDArray[np.int64], windows: NDArray[np.int64]) -> list[Finding]:
    """Findings on numbers and times (2, n) of the frames with a spot message, and of those with a window."""
    findings = []
    for topic, (_, times_ns) in ((SPOT.topic, spots), (WINDOW.topic, windows)):
        earlier_ns = times_ns[1:][np.diff(times_ns) < 0].tolist()
        if earlier_ns:
            first = utc_text(earlier_ns[0])
            findings += _errors(f"{topic}: the time decreases {len(earlier_ns)} times, first at {first}")
    numbers = spots[0]
    steps = np.diff(numbers)
    gaps = np.flatnonzero(steps > 1)
    if len(not_rising := np.flatnonzero(steps <= 0)):
        findings += _errors(f"{SPOT.topic}: frame numbers do not rise in {len(not_rising)} places")
    if len(gaps):
        shown = ", ".join(f"{numbers[at] + 1}-{numbers[at + 1] - 1}" for at in gaps[:_MAX_SHOWN_GAPS])
        more = f" and {len(gaps) - _MAX_SHOWN_GAPS} more gaps" if len(gaps) > _MAX_SHOWN_GAPS else ""
        text = f"{SPOT.topic}: {(steps[gaps] - 1).sum()} frames are missing: {shown}{more}"
        findings.append(Finding("warning", text))
    without = len(numbers) - windows.shape[1]
    if windows.size and without > 0:
        text = f"{WINDOW.topic}: {without} frames have a spot message and no window"
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
