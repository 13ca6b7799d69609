"""Changed bytes and truncated files are found and named, and everything else is read."""

import contextlib
import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader

from acquisition.record.check import Finding, check_record
from acquisition.record.contents import read_contents
from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover
from acquisition.record.topics import SCHEMA_VERSION
from acquisition.record.without_index import RecordSearch
from acquisition.record.writer import RecordWriter
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import RecordError
from processing.spot import Spot
from tests.acquisition.record.samples import EPOCH_OFFSET_NS, write_sample

FRAMES = 64


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    write_sample(path, FRAMES)
    return path.read_bytes()


def errors(findings: list[Finding]) -> list[str]:
    return [finding.text for finding in findings if finding.severity == "error"]


def flipped(data: bytes, place: int, bit: int = 0) -> bytes:
    changed = bytearray(data)
    changed[place] ^= 1 << bit
    return bytes(changed)


def test_a_whole_record_has_no_findings(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole)
    assert check_record(path) == []


def test_a_flipped_byte_in_a_chunk_is_named_and_the_rest_is_read(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole)
    with path.open("rb") as file:
        contents = read_contents(file)
    spot = next(number for number, channel in contents.channels.items() if channel.topic == "/spot")
    place = [chunk for chunk in contents.chunks if spot in chunk.channels][1]
    path.write_bytes(flipped(whole, place.offset + place.length // 2))
    with RecordReader(path) as reader:
        assert len(reader.spots()) == FRAMES - 16
        (damage,) = reader.damages
        assert "/spot" in damage.topics
        assert "/swing" in damage.topics
        assert damage.start_ns == EPOCH_OFFSET_NS + 16 * 10_000_000
        assert sum(1 for _ in reader.windows()) == FRAMES
    (first, *_) = errors(check_record(path))
    assert "/spot" in first
    assert "2026-09-21 " in first
    assert f"byte {place.offset}" in first


def flip_everywhere(tmp_path: Path, whole: bytes, places: list[int]) -> None:
    """Each flip alone: `check` finds it, and at most one chunk cannot be read."""
    path = tmp_path / "run.mcap"
    for place in places:
        path.write_bytes(flipped(whole, place, place % 8))
        assert errors(check_record(path)), f"byte {place} of {len(whole)} was flipped and not found"
        with RecordReader(path) as reader:
            windows = sum(1 for _ in reader.windows())
            assert FRAMES - 16 <= windows <= FRAMES
            assert FRAMES - 16 <= len(reader.spots()) <= FRAMES
            assert reader.epoch_offset_ns == EPOCH_OFFSET_NS


@pytest.mark.slow
def test_any_flipped_byte_is_found(tmp_path: Path, whole: bytes) -> None:
    rng = np.random.default_rng(3)
    flip_everywhere(tmp_path, whole, rng.choice(len(whole), 250, replace=False).tolist())


@pytest.mark.slow
def test_any_flipped_byte_is_found_everywhere(tmp_path: Path, whole: bytes) -> None:
    flip_everywhere(tmp_path, whole, list(range(0, len(whole), 197)))


def what_is_left(path: Path) -> tuple[set[int], set[int], set[str]]:
    """Frame numbers of spots and of windows that can be read, and the names of intact attachments."""
    with RecordReader(path) as reader:
        windows = {window.sequence for window in reader.windows()}
        assert reader.metadata["session"]["operator"] == "Ä. Tester"
        return set(reader.spots()["sequence"].tolist()), windows, set(reader.attachments)


def test_one_bit_of_a_cut_file_loses_at_most_its_chunk(tmp_path: Path, whole: bytes) -> None:
    rng = np.random.default_rng(6)
    path = tmp_path / "run.mcap"
    for length in (len(whole) - 37, 2 * len(whole) // 3):
        path.write_bytes(whole[:length])
        spots, windows, attachments = what_is_left(path)
        for place in rng.integers(0, length, 60).tolist():
            path.write_bytes(flipped(whole[:length], place, place % 8))
            left_spots, left_windows, left_attachments = what_is_left(path)
            assert left_spots <= spots
            assert left_windows <= windows
            assert len(spots - left_spots) <= 16
            assert len(windows - left_windows) <= 16
            assert len(spots - left_spots) + len(windows - left_windows) <= 16
            assert len(attachments - left_attachments) <= 1
        assert attachments == {"configuration.toml", "any.bin"}


def test_the_times_of_a_cut_file_are_proved_before_chunks_are_left_out_by_them(
    tmp_path: Path, whole: bytes
) -> None:
    path = tmp_path / "run.mcap"
    cut = whole[:-37]
    path.write_bytes(cut)
    with RecordReader(path) as reader:
        expected = reader.contents
        assert reader.contents.damage == []
        chunks = list(reader.contents.chunks)
    for bit, place in enumerate(chunks):
        for first_or_last in (0, 8):
            byte, of_byte = divmod(14 + 7 * bit, 8)
            path.write_bytes(flipped(cut, place.offset + 9 + first_or_last + byte % 8, of_byte))
            with RecordReader(path) as reader:
                found = reader.contents
                assert (found.start_ns, found.end_ns) == (expected.start_ns, expected.end_ns)
                assert f"chunk at byte {place.offset} have changed" in " ".join(found.damage)
                later = [block["sequence"] for block in reader.spot_blocks(30 * 10_000_000)]
                assert np.concatenate(later).tolist() == list(range(30, FRAMES))


def test_an_attachment_is_read_from_its_second_copy(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    first = whole.index(b"[session]")
    last = whole.rindex(b"[session]")
    assert first < last
    path.write_bytes(flipped(whole, first))
    with RecordReader(path) as reader:
        assert reader.attachments["configuration.toml"] == b"[session]\n"
        assert "attachment configuration.toml: its checksum" in reader.damages[0].what
    path.write_bytes(flipped(flipped(whole, first), last))
    with RecordReader(path) as reader:
        assert "configuration.toml" not in reader.attachments
    copy = tmp_path / "copy.mcap"
    assert any("configuration.toml" in damage.what for damage in recover(path, copy).lost)
    (told,) = check_record(copy)
    assert told.severity == "warning"
    assert "lost parts: attachment configuration.toml: its checksum does not match" in told.text


def test_metadata_are_read_from_the_copy_with_a_checksum(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    changed = whole.replace("Ä. Tester".encode(), "Ä. Faster".encode(), 1)
    for data in (changed, changed[: len(changed) - 37]):
        path.write_bytes(data)
        with RecordReader(path) as reader:
            assert reader.metadata["session"]["operator"] == "Ä. Tester"
            assert "metadata session: bytes have changed; a copy is taken" in reader.contents.damage


def test_many_changes_at_once_never_break_the_reader(tmp_path: Path, whole: bytes) -> None:
    rng = np.random.default_rng(4)
    path = tmp_path / "run.mcap"
    for _ in range(60):
        changed = np.frombuffer(whole, np.uint8).copy()
        changed[rng.integers(8, len(whole), 40)] = rng.integers(0, 256, 40)
        path.write_bytes(changed.tobytes())
        with contextlib.suppress(RecordError):
            check_record(path)
        with contextlib.suppress(RecordError), RecordReader(path) as reader:
            reader.spots()
            reader.events()


def cut_places(whole: bytes, count: int) -> list[int]:
    rng = np.random.default_rng(5)
    return [
        *rng.integers(1500, len(whole) - 1, count).tolist(),
        len(whole) - 1,
        len(whole) - 8,
        len(whole) - 37,
    ]


def test_a_cut_file_is_read_up_to_its_last_whole_chunk_and_recovered(tmp_path: Path, whole: bytes) -> None:
    for number, length in enumerate(cut_places(whole, 40)):
        path, copy = tmp_path / f"cut-{number}.mcap", tmp_path / f"whole-{number}.mcap"
        path.write_bytes(whole[:length])
        with RecordReader(path) as reader:
            assert reader.truncated
            spots = reader.spots()
            assert spots["sequence"].tolist() == list(range(len(spots)))
            windows = [window.sequence for window in reader.windows()]
            assert windows == list(range(len(windows)))
        assert any("cut short" in text for text in errors(check_record(path)))
        found = recover(path, copy)
        assert path.read_bytes() == whole[:length]
        assert found.messages.get("/spot", 0) == len(spots)
        assert found.lost == ()
        assert errors(check_record(copy)) == []
        with RecordReader(copy) as reader:
            assert not reader.truncated
            assert reader.spots().tobytes() == spots.tobytes()
            assert reader.metadata["recovery"]["source_sha256"] == sha256_of(path)
            assert reader.metadata["session"]["operator"] == "Ä. Tester"
        with copy.open("rb") as file:
            independent = make_reader(file, validate_crcs=True)
            assert sum(1 for _ in independent.iter_messages(topics=["/spot"])) == len(spots)


def test_a_file_that_was_cut_before_its_first_message_has_no_time(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    with RecordWriter(tmp_path / "whole.mcap", 0) as writer:
        cut.write_bytes(writer.path.read_bytes())
    said = [finding.text for finding in check_record(cut) if "cut short" in finding.text]
    assert len(said) == 1
    assert said[0].startswith("the file was cut short before anything was measured, after ")


def test_a_damaged_record_is_recovered_without_the_damaged_chunk(tmp_path: Path, whole: bytes) -> None:
    path, copy = tmp_path / "run.mcap", tmp_path / "whole.mcap"
    path.write_bytes(whole)
    with path.open("rb") as file:
        place = read_contents(file).chunks[2]
    path.write_bytes(flipped(whole, place.offset + place.length - 20))
    found = recover(path, copy)
    assert len(found.lost) == 1
    assert found.lost[0].start_ns == place.start_ns
    with RecordReader(copy) as reader:
        assert reader.metadata["recovery"]["lost_chunks"] == "1"
        assert reader.damages == []
        assert len(reader.attachments) == 2
    assert errors(check_record(copy)) == []


def test_a_record_whose_summary_is_damaged_is_read_by_walking_through_it(
    tmp_path: Path, whole: bytes
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(flipped(whole, len(whole) - 200))
    with RecordReader(path) as reader:
        assert not reader.truncated
        assert len(reader.spots()) == FRAMES
        assert any("summary" in text for text in reader.contents.damage)


def overview(path: Path) -> dict[str, Any]:
    """What `rig info` prints of a record."""
    names = ("whole", "library", "start_ns", "end_ns", "chunk_count", "metadata", "attachments", "damage")
    with RecordReader(path) as reader:
        read = {"counts": reader.counts, "losses": reader.losses()}
        return {name: getattr(reader.contents, name) for name in names} | read


def test_info_reads_no_chunk(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole)
    expected = overview(path)
    with path.open("rb") as file:
        chunks = read_contents(file).chunks
    scrambled = bytearray(whole)
    for chunk in chunks:
        scrambled[chunk.offset : chunk.offset + chunk.length] = bytes(chunk.length)
    path.write_bytes(scrambled)
    assert overview(path) == expected
    assert expected["counts"]["/spot"] == FRAMES
    assert expected["metadata"]["record"]["schema_version"] == str(SCHEMA_VERSION)
    assert expected["end_ns"] - expected["start_ns"] == pytest.approx(0.64e9)
    assert expected["whole"]
    path.write_bytes(whole[: len(whole) - 9])
    cut = overview(path)
    assert not cut["whole"]
    assert cut["counts"] == expected["counts"]
    assert cut["chunk_count"] == expected["chunk_count"]


def test_gaps_and_repeated_frames_are_told(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    sequences = [0, 1, 2, 5, 6, 9, 9, 8]
    with RecordWriter(path, EPOCH_OFFSET_NS) as writer:
        times = np.array(sequences) * 1000
        ones = np.ones(len(sequences))
        spots = [Spot(*[1.0] * 10, flags=0)] * len(sequences)
        zeros = [0] * len(sequences)
        deflections = Deflections(times, ones, ones, ones, ones, DeflectionUnit.RAD)
        writer.write_spots(sequences, zeros, zeros, spots, deflections)
        writer.write_window(7, 7000, np.zeros((2, 2), np.uint8), 0, 0)
    findings = check_record(path)
    assert Finding("warning", "/spot: 4 frames are missing: 3-4, 7-8") in findings
    assert any("the time decreases 1 times" in text for text in errors(findings))
    assert any("do not rise in 2 places" in text for text in errors(findings))
    assert any("1 windows have no spot, first frame 7" in finding.text for finding in findings)


def test_the_hash_is_compared_with_the_results(tmp_path: Path, whole: bytes) -> None:
    path, results = tmp_path / "run-1.mcap", tmp_path / "results.json"
    path.write_bytes(whole)
    results.write_text(json.dumps({"runs": [{"record": "run-1.mcap", "sha256": sha256_of(path)}]}))
    assert check_record(path, results) == [Finding("note", "SHA-256 is the one in results.json")]
    results.write_text(json.dumps({"runs": [{"record": "run-1.mcap", "sha256": "0" * 64}]}))
    assert "not the one that was fitted" in errors(check_record(path, results))[0]
    results.write_text(json.dumps({"runs": []}))
    assert "does not contain run-1.mcap" in check_record(path, results)[0].text


def test_a_length_that_claims_the_world_takes_no_memory(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(whole)
    with path.open("rb") as file:
        place = read_contents(file).chunks[0]
    changed = bytearray(whole)
    size_at = place.offset + 9 + 16
    changed[size_at : size_at + 8] = struct.pack("<Q", 2**40)
    path.write_bytes(changed)
    with RecordReader(path) as reader:
        reader.spots()
        reader.events()
        assert any("head has changed" in damage.what for damage in reader.damages)


def test_a_cut_file_is_listed_without_unpacking_its_chunks(
    tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A day's record has 200,000: where head and message index of one agree, its times are proved by them."""

    def unpacked(*_: object) -> None:
        raise AssertionError("a chunk was unpacked")

    path = tmp_path / "run.mcap"
    path.write_bytes(whole)
    with path.open("rb") as file:
        expected = list(read_contents(file).chunks)
    path.write_bytes(whole[:-37])
    monkeypatch.setattr("acquisition.record.without_index.open_chunk", unpacked)
    with path.open("rb") as file:
        contents = read_contents(file)
    assert list(contents.chunks) == expected
    assert contents.damage == []
    # where they contradict each other, it is
    changed = flipped(whole[:-37], expected[1].offset + 9, 3)
    path.write_bytes(changed)
    with path.open("rb") as file, pytest.raises(AssertionError, match="unpacked"):
        read_contents(file)


def test_a_file_without_a_checksum_of_its_data_is_not_called_damaged_for_that(
    tmp_path: Path, whole: bytes
) -> None:
    """MCAP: a data section's CRC of 0 means that there is none, as other writers have it."""
    path = tmp_path / "run.mcap"
    at = whole.rindex(b"\x0f" + (4).to_bytes(8, "little")) + 9
    path.write_bytes(whole[:at] + bytes(4) + whole[at + 4 :])
    assert errors(check_record(path)) == []
    path.write_bytes(flipped(whole, at))
    assert len(errors(check_record(path))) == 1


def test_a_record_without_checksum_is_believed_only_if_the_next_one_fits_into_the_file() -> None:
    """Bytes that look like the head of a record are found in any picture: its end must be there."""
    index = bytes([Opcode.MESSAGE_INDEX]) + struct.pack("<QHI", 6, 1, 0)
    following = bytes([Opcode.METADATA]) + struct.pack("<Q", 40) + bytes(40)
    whole = index + following
    assert RecordSearch(io.BytesIO(whole)).is_sound(0, followed=True)
    for missing in (1, 9, 18, 40):
        assert not RecordSearch(io.BytesIO(whole[:-missing])).is_sound(0, followed=True)
