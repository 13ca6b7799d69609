"""Changed bytes and truncated files are found and named, and everything else is read."""

import contextlib
import json
import struct
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from mcap.reader import make_reader

from acquisition.record import pixels_path
from acquisition.record.check import Finding, check_record, recover
from acquisition.record.chunk import ChunkEntry
from acquisition.record.digest import sha256_of, utc_text
from acquisition.record.read_file import ReadFile
from acquisition.record.reader import RecordReader
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RecordError
from tests.acquisition.record.samples import EPOCH_OFFSET_NS, SPOT, write_sample

FRAMES = 64


class Files(NamedTuple):
    """The bytes of a record's two files."""

    numbers: bytes
    pixels: bytes

    def lay(self, path: Path) -> None:
        """Write them under a name."""
        path.write_bytes(self.numbers)
        pixels_path(path).write_bytes(self.pixels)

    def flipped(self, place: int) -> "Files":
        """One bit changed; places count on from the numbers into the pixels."""
        inside = place - len(self.numbers)
        if inside < 0:
            return self._replace(numbers=flipped(self.numbers, place, place % 8))
        return self._replace(pixels=flipped(self.pixels, inside, place % 8))


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Files:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    write_sample(path, FRAMES)
    return Files(path.read_bytes(), pixels_path(path).read_bytes())


@pytest.fixture(scope="module")
def whole(both: Files) -> bytes:
    """The file of numbers."""
    return both.numbers


def chunks_of(path: Path) -> list[ChunkEntry]:
    file = ReadFile(path)
    file.close()
    return list(file.chunks)


def errors(findings: list[Finding]) -> list[str]:
    return [finding.text for finding in findings if finding.severity == "error"]


def flipped(data: bytes, place: int, bit: int = 0) -> bytes:
    changed = bytearray(data)
    changed[place] ^= 1 << bit
    return bytes(changed)


def test_a_whole_record_has_no_findings_also_without_its_pixels(tmp_path: Path, both: Files) -> None:
    path = tmp_path / "run.mcap"
    both.lay(path)
    assert check_record(path) == []
    with RecordReader(path) as reader:
        assert reader.is_sound
        assert sum(1 for _ in reader.windows()) == FRAMES
    pixels_path(path).unlink()
    assert check_record(path) == []
    with RecordReader(path) as reader:
        assert not reader.truncated
        assert len(reader.spots()) == FRAMES
        assert list(reader.windows()) == list(reader.images()) == []


def test_pixels_of_another_record_are_not_taken(tmp_path: Path, both: Files) -> None:
    path = tmp_path / "run.mcap"
    write_sample(path, FRAMES, seed=2)
    pixels_path(path).write_bytes(both.pixels)
    with RecordReader(path) as reader:
        assert list(reader.windows()) == []
        assert "run.pixels.mcap: has not the pixels of this record" in " ".join(reader.doubts())
    with pytest.raises(RecordError, match=r"name the record beside it, run\.mcap"):
        RecordReader(pixels_path(path))


def test_a_flipped_byte_in_a_chunk_is_named_and_the_rest_is_recovered(tmp_path: Path, both: Files) -> None:
    path, copy = tmp_path / "run.mcap", tmp_path / "whole.mcap"
    both.lay(path)
    place = chunks_of(path)[1]
    both._replace(numbers=flipped(both.numbers, place.offset + place.length // 2)).lay(path)
    with RecordReader(path) as reader:
        assert len(reader.spots()) == FRAMES - 16
        (damage,) = reader.damages
        assert damage.startswith(f"chunk at byte {place.offset} (")
        assert "/spot /swing" in damage
        assert utc_text(EPOCH_OFFSET_NS + 16 * 10_000_000) in damage
        assert sum(1 for _ in reader.windows()) == FRAMES
    assert errors(check_record(path)) == [f"run.mcap: {damage}"]
    assert recover(path, copy)["lost"] == damage
    with RecordReader(copy) as reader:
        assert reader.metadata["recovery"]["lost"] == damage
        assert (len(reader.spots()), reader.damages, len(reader.attachments)) == (FRAMES - 16, [], 2)
    assert errors(check_record(copy)) == []


def places_of_every_kind(data: bytes) -> list[int]:
    """Opcode, length, first and last byte of the first two records of each kind in MCAP; both magics."""
    places, seen = [0, len(data) - 1], Counter[int]()
    at = 8
    while at < len(data) - 8:
        (length,) = struct.unpack_from("<Q", data, at + 1)
        seen[data[at]] += 1
        if seen[data[at]] <= 2:
            places += [at, at + 1, at + 9, at + 8 + length]
        at += 9 + length
    return places


@pytest.mark.slow
def test_any_flipped_byte_is_found(tmp_path: Path, both: Files) -> None:
    """`check` finds it, and at most one chunk cannot be read; hundreds: row `damage-lost`, validation."""
    path, count = tmp_path / "run.mcap", sum(map(len, both))
    some = np.random.default_rng(3).choice(count, 60, replace=False).tolist()
    pixels = [len(both.numbers) + place for place in places_of_every_kind(both.pixels)]
    for place in [*some, *places_of_every_kind(both.numbers), *pixels]:
        both.flipped(place).lay(path)
        assert errors(check_record(path)), f"byte {place} of {len(both.numbers)} was flipped and not found"
        with RecordReader(path) as reader:
            assert FRAMES - 16 <= sum(1 for _ in reader.windows()) <= FRAMES
            assert FRAMES - 16 <= len(reader.spots()) <= FRAMES
            assert reader.epoch_offset_ns == EPOCH_OFFSET_NS


def what_is_left(path: Path) -> tuple[set[int], set[int], set[str]]:
    """Frame numbers of spots and of windows that can be read, and the names of intact attachments."""
    with RecordReader(path) as reader:
        windows = {window.sequence for window in reader.windows()}
        assert reader.metadata["session"]["operator"] == "Ä. Tester"
        return set(reader.spots()["sequence"].tolist()), windows, set(reader.attachments)


def test_one_bit_of_a_cut_file_loses_at_most_its_chunk(tmp_path: Path, both: Files) -> None:
    rng = np.random.default_rng(6)
    path = tmp_path / "run.mcap"
    for left in (lambda data: data[:-37], lambda data: data[: 2 * len(data) // 3]):
        cut = Files(left(both.numbers), left(both.pixels))
        cut.lay(path)
        spots, windows, attachments = what_is_left(path)
        for place in rng.integers(0, sum(map(len, cut)), 60).tolist():
            cut.flipped(place).lay(path)
            left_spots, left_windows, left_attachments = what_is_left(path)
            assert left_spots <= spots
            assert left_windows <= windows
            assert len(spots - left_spots) + len(windows - left_windows) <= 16
            assert len(attachments - left_attachments) <= 1
        assert attachments == {"configuration.toml", "any.bin"}


def test_an_attachment_is_read_from_its_second_copy(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    first = whole.index(b"[session]")
    last = whole.rindex(b"[session]")
    assert first < last
    path.write_bytes(flipped(whole, first))
    with RecordReader(path) as reader:
        assert reader.attachments["configuration.toml"] == b"[session]\n"
        assert "attachment configuration.toml: its checksum" in reader.damages[0]
    path.write_bytes(flipped(flipped(whole, first), last))
    with RecordReader(path) as reader:
        assert "configuration.toml" not in reader.attachments
    copy = tmp_path / "copy.mcap"
    assert "configuration.toml" in recover(path, copy)["lost"]
    (told,) = check_record(copy)
    assert told.severity == "warning"
    assert "; lost: byte " in told.text
    assert "attachment configuration.toml: its checksum does not match" in told.text


def test_metadata_are_read_from_the_copy_with_a_checksum(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    changed = whole.replace("Ä. Tester".encode(), "Ä. Faster".encode(), 1)
    for data in (changed, changed[: len(changed) - 37]):
        path.write_bytes(data)
        with RecordReader(path) as reader:
            assert reader.metadata["session"]["operator"] == "Ä. Tester"


def test_many_changes_at_once_never_break_the_reader(tmp_path: Path, both: Files) -> None:
    rng = np.random.default_rng(4)
    path = tmp_path / "run.mcap"
    for _ in range(60):
        changed = [np.frombuffer(data, np.uint8).copy() for data in both]
        for data in changed:
            data[rng.integers(8, len(data), 40)] = rng.integers(0, 256, 40)
        Files(*(data.tobytes() for data in changed)).lay(path)
        with contextlib.suppress(RecordError):
            check_record(path)
        with contextlib.suppress(RecordError), RecordReader(path) as reader:
            reader.spots()
            reader.events()
            list(reader.windows())


def cuts(both: Files, count: int) -> list[Files]:
    rng = np.random.default_rng(5)
    ends = [(rng.uniform(), rng.uniform()) for _ in range(count)]
    # the head of both, which is forced to the disk before anything is measured, is there
    heads = [data.index(b"/spot" if place == 0 else b"/window") for place, data in enumerate(both)]
    lengths = [
        [
            round(head + end * (len(data) - 1 - head))
            for head, end, data in zip(heads, pair, both, strict=True)
        ]
        for pair in ends
    ]
    lengths += [[len(data) - missing for data in both] for missing in (1, 8, 37)]
    return [Files(both.numbers[:n], both.pixels[:p]) for n, p in lengths]


def test_a_cut_file_is_read_up_to_its_last_whole_chunk_and_recovered(tmp_path: Path, both: Files) -> None:
    for number, cut in enumerate(cuts(both, 20)):
        path, copy = tmp_path / f"cut-{number}.mcap", tmp_path / f"whole-{number}.mcap"
        cut.lay(path)
        with RecordReader(path) as reader:
            assert reader.truncated
            spots = reader.spots()
            assert spots["sequence"].tolist() == list(range(len(spots)))
            windows = [window.sequence for window in reader.windows()]
            assert windows == list(range(len(windows)))
            # the index of the last chunk may be cut, whose messages are read
            assert reader.counts.get("/spot", 0) == len(spots)
            assert reader.counts.get("/window", 0) == len(windows)
        assert any("cut short" in text for text in errors(check_record(path)))
        found = recover(path, copy)
        assert (path.read_bytes(), pixels_path(path).read_bytes()) == cut
        ends = found["lost"].split("; ") if found["lost"] else []
        assert all("bytes after the last complete entry" in end for end in ends)
        assert errors(check_record(copy)) == []
        with RecordReader(copy) as reader:
            assert not reader.truncated
            assert reader.spots().tobytes() == spots.tobytes()
            assert [window.sequence for window in reader.windows()] == windows
            assert reader.metadata["recovery"]["source_sha256"] == sha256_of(path)
            assert reader.metadata["session"]["operator"] == "Ä. Tester"
        with copy.open("rb") as file:
            independent = make_reader(file, validate_crcs=True)
            assert sum(1 for _ in independent.iter_messages(topics=["/spot"])) == len(spots)


@pytest.mark.parametrize("cut_at", [1.0, 0.7, 0.3])
def test_a_file_that_was_appended_is_named_and_not_read_as_the_same_run(
    tmp_path: Path, whole: bytes, cut_at: float
) -> None:
    """Behind a whole record it was passed over, and the frames behind a cut one were taken for its own."""
    path, alone = tmp_path / "joined.mcap", tmp_path / "alone.mcap"
    first = whole[: round(cut_at * len(whole))]
    alone.write_bytes(first)
    path.write_bytes(first + whole)
    with RecordReader(alone) as wanted, RecordReader(path) as reader:
        assert reader.spots().tobytes() == wanted.spots().tobytes()
        assert reader.counts == wanted.counts
        assert reader.truncated == (cut_at < 1.0)
    begins = f"{len(whole)} bytes from byte {len(first)} on are of another file"
    assert any(begins in text for text in errors(check_record(path)))
    assert begins in recover(path, tmp_path / "copy.mcap")["lost"]


def test_a_file_that_was_cut_before_its_first_message_has_no_time(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    with RecordWriter(tmp_path / "whole.mcap", 0) as writer:
        cut.write_bytes(writer.path.read_bytes())
    said = [finding.text for finding in check_record(cut) if "cut short" in finding.text]
    assert len(said) == 1
    assert said[0].startswith("cut.mcap was cut short before anything was measured, after ")


def test_a_record_whose_summary_is_damaged_is_read_by_walking_through_it(
    tmp_path: Path, whole: bytes
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(flipped(whole, len(whole) - 200))
    with RecordReader(path) as reader:
        assert not reader.truncated
        assert len(reader.spots()) == FRAMES
        assert any("summary" in damage for damage in reader.damages)


def overview(path: Path) -> dict[str, Any]:
    """What `rig record info` prints of a record."""
    names = ("is_complete", "library", "start_ns", "end_ns", "attachments", "damages")
    with RecordReader(path) as reader:
        read = {"counts": reader.counts, "losses": reader.losses(), "chunks": len(reader.numbers.chunks)}
        return {name: getattr(reader.numbers, name) for name in names} | read


def test_info_reads_no_chunk(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole)
    expected = overview(path)
    chunks = chunks_of(path)
    scrambled = bytearray(whole)
    for chunk in chunks:
        scrambled[chunk.offset : chunk.offset + chunk.length] = bytes(chunk.length)
    path.write_bytes(scrambled)
    assert overview(path) == expected
    assert expected["counts"]["/spot"] == FRAMES
    assert expected["end_ns"] - expected["start_ns"] == pytest.approx(0.64e9)
    assert expected["is_complete"]
    path.write_bytes(whole[: len(whole) - 9])
    cut = overview(path)
    assert not cut["is_complete"]
    assert (cut["counts"], cut["chunks"]) == (expected["counts"], expected["chunks"])


def test_gaps_and_repeated_frames_are_told(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    sequences = [0, 1, 2, 5, 6, 9, 9, 8]
    with RecordWriter(path, EPOCH_OFFSET_NS) as writer:
        ones = np.ones((4, len(sequences)))
        deflections = Deflections(np.array(sequences) * 1000, *ones, DeflectionUnit.RAD)
        writer.write_spots(sequences, sequences, sequences, [SPOT] * len(sequences), deflections)
    findings = check_record(path)
    assert Finding("warning", "/spot: 4 frames are missing: 3-4, 7-8") in findings
    assert any("the time decreases 1 times" in text for text in errors(findings))
    assert any("do not rise in 2 places" in text for text in errors(findings))


def test_the_hash_is_compared_with_the_results(tmp_path: Path, whole: bytes) -> None:
    path, results = tmp_path / "run-1.mcap", tmp_path / "results.json"
    path.write_bytes(whole)
    results.write_text(json.dumps({"runs": [{"record": "run-1.mcap", "sha256": sha256_of(path)}]}))
    assert check_record(path, results) == [Finding("note", "SHA-256 is the one in results.json: run-1.mcap")]
    results.write_text(json.dumps({"runs": [{"record": "run-1.mcap", "sha256": "0" * 64}]}))
    assert errors(check_record(path, results)) == ["run-1.mcap has another SHA-256 than results.json states"]
    results.write_text(json.dumps({"runs": []}))
    assert "does not contain run-1.mcap" in check_record(path, results)[0].text


def test_a_length_that_claims_the_world_takes_no_memory(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole)
    place = chunks_of(path)[0]
    changed = bytearray(whole)
    size_at = place.offset + 9 + 16
    changed[size_at : size_at + 8] = struct.pack("<Q", 2**40)
    path.write_bytes(changed)
    with RecordReader(path) as reader:
        reader.spots()
        reader.events()
        assert any("head has changed" in damage for damage in reader.damages)
