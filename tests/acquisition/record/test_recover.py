"""What `rig recover` makes of a file that was put together wrongly, or that a kill left half repaired."""

import os
import shutil
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from acquisition.record.check import check_record
from acquisition.record.chunk_order import Frames, longest_chain
from acquisition.record.contents import read_contents
from acquisition.record.reader import RecordReader
from acquisition.record.recover import Recovery, recover
from acquisition.record.repaired import copies_of, fullest, originals, repaired
from tests.acquisition.record.samples import write_sample

FRAMES = 96


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """A record without its ending, so that its chunks are found one after the other."""
    path = tmp_path / "run-1.mcap"
    write_sample(path, FRAMES, flush_interval_s=0.0)
    with path.open("rb") as file:
        contents = read_contents(file)
    last = list(contents.chunks)[-1]
    data = path.read_bytes()
    place = last.offset + last.length
    while data[place] == 0x07:  # message indexes
        place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
    path.write_bytes(data[:place])
    return path


def blocks(path: Path) -> tuple[bytes, list[bytes]]:
    """What stands before the first chunk, and each chunk with its message indexes."""
    with RecordReader(path) as reader:
        starts = [place.offset for place in reader.contents.chunks]
    data = path.read_bytes()
    ends = [*starts[1:], len(data)]
    return data[: starts[0]], [data[a:b] for a, b in zip(starts, ends, strict=True)]


def numbers(path: Path) -> tuple[list[int], list[int]]:
    with RecordReader(path) as reader:
        return reader.spots()["sequence"].tolist(), [window.sequence for window in reader.windows()]


def recovered(path: Path, head: bytes, parts: list[bytes], name: str) -> tuple[Recovery, Path]:
    source, copy = path.with_name(f"{name}.mcap"), path.with_name(f"{name}-copy.mcap")
    source.write_bytes(head + b"".join(parts))
    found = recover(source, copy)
    assert not [item for item in check_record(copy) if item.severity == "error"]
    return found, copy


def test_chunks_that_stand_twice_are_copied_once_and_said(cut: Path) -> None:
    head, parts = blocks(cut)
    expected = numbers(cut)
    found, copy = recovered(cut, head, [*parts[:4], parts[1], parts[2], *parts[4:]], "twice")
    assert numbers(copy) == expected
    assert len(found.doubles) == 2
    assert "the same as the one at byte" in found.doubles[0]
    assert (found.foreign, found.moved) == ((), 0)
    (told,) = (item.text for item in check_record(copy) if item.severity == "warning")
    assert "doubles left out: chunk at byte" in told


def test_chunks_out_of_order_are_put_in_order_and_said(cut: Path) -> None:
    head, parts = blocks(cut)
    expected = numbers(cut)
    mixed = list(parts)
    np.random.default_rng(5).shuffle(mixed)
    found, copy = recovered(cut, head, mixed, "mixed")
    assert numbers(copy) == expected
    assert found.moved > 0
    assert (found.doubles, found.foreign) == ((), ())
    assert any("chunks moved" in item.text for item in check_record(copy))


@pytest.mark.parametrize("offset_ns", [0, 1, 3_600_000_000_000])
def test_a_chunk_of_another_run_does_not_come_in_under_the_numbers_of_this_one(
    cut: Path, offset_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other run began at the same offset or at another; its frames have the same numbers."""
    head, parts = blocks(cut)
    expected = numbers(cut)
    other = cut.with_name("other.mcap")
    monkeypatch.setattr(
        "tests.acquisition.record.samples.EPOCH_OFFSET_NS", 1_790_000_000_000_000_000 + offset_ns
    )
    write_sample(other, FRAMES, flush_interval_s=0.0, seed=9)
    _, strange = blocks(other)
    with RecordReader(other) as reader:
        topics = {number: channel.topic for number, channel in reader.contents.channels.items()}
        of_spots, of_windows = (
            next(
                k
                for k, place in enumerate(reader.contents.chunks)
                if topic in map(topics.get, place.channels)
            )
            for topic in ("/spot", "/window")
        )
    # of the same offset, numbers and times nothing tells which was first, but that it stands first
    at = 1 if offset_ns else len(parts) - 1
    spliced = [*parts[:at], strange[of_spots], strange[of_windows], *parts[at:]]
    found, copy = recovered(cut, head, spliced, "foreign")
    assert numbers(copy) == expected
    assert len(found.foreign) == 2
    with RecordReader(cut) as ours, RecordReader(copy) as theirs:
        assert ours.spots().tobytes() == theirs.spots().tobytes()
    assert any("foreign left out" in item.text for item in check_record(copy))


def test_the_longest_chain_is_that_of_all_chains() -> None:
    """Against every subset, of few chunks drawn at random."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        frames = [
            Frames(first, first + int(rng.integers(0, 4)), time, time + int(rng.integers(0, 4)), True)
            for first, time in rng.integers(0, 12, (int(rng.integers(1, 8)), 2)).tolist()
        ]
        best = 0
        for subset in range(1 << len(frames)):
            chosen = sorted(item for number, item in enumerate(frames) if subset >> number & 1)
            if all(a.last < b.first and a.last_ns < b.first_ns for a, b in pairwise(chosen)):
                best = max(best, sum(item.most for item in chosen))
        assert sum(frames[number].most for number in longest_chain(frames)) == best


def stump(path: Path) -> Path:
    """Half a copy, as a killed repair leaves it."""
    head, parts = blocks(path)
    copy = path.with_name(f"{path.stem}-recovered.mcap")
    copy.write_bytes(head + b"".join(parts[:2]))
    return copy


def test_half_a_copy_takes_nobodys_place(cut: Path) -> None:
    half = stump(cut)
    before = half.read_bytes()
    assert fullest(cut, copies_of(cut)) == cut
    whole, made = repaired(cut)
    assert (whole.name, made is not None) == ("run-1-recovered-2.mcap", True)
    assert half.read_bytes() == before
    assert numbers(whole) == numbers(cut)
    assert fullest(cut, copies_of(cut)) == whole
    # made of the record as it is: it is not made again
    assert repaired(cut) == (whole, None)
    assert {path: set(copies) for path, copies in originals(cut.parent.glob("*.mcap")).items()} == {
        cut: {half, whole}
    }


def test_a_copy_of_less_of_the_record_is_not_taken(cut: Path) -> None:
    """Recovered while it was measured: the record has gone on since."""
    data = cut.read_bytes()
    head, parts = blocks(cut)
    cut.write_bytes(head + b"".join(parts[:4]))
    early, _ = repaired(cut)
    cut.write_bytes(data)
    assert fullest(cut, [early]) == cut
    late, _ = repaired(cut)
    assert late != early
    assert fullest(cut, [early, late]) == late


_REPAIR = """
import sys
from itertools import pairwise
from pathlib import Path
from acquisition.record import {module}
from acquisition.record.repaired import repaired
done = {module}.{function}
def waiting(*words, **named):
    print("there", flush=True)
    sys.stdin.read()
    return done(*words, **named)
{module}.{function} = waiting
repaired(Path(sys.argv[1]))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="killed by a signal of POSIX")
@pytest.mark.parametrize(
    ("module", "function"),
    [("recover", "copy_head"), ("recover", "is_sound"), ("whole_file", "_take_free_name")],
)
def test_killed_while_it_repairs_the_next_one_completes(cut: Path, module: str, function: str) -> None:
    before = cut.read_bytes()
    process = subprocess.Popen(
        [sys.executable, "-c", _REPAIR.format(module=module, function=function), str(cut)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"there\n"
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert copies_of(cut) == []
    whole, made = repaired(cut)
    assert made is not None
    assert whole.name == "run-1-recovered.mcap"
    assert numbers(whole) == numbers(cut)
    assert cut.read_bytes() == before
    assert sorted(path.name for path in cut.parent.iterdir()) == ["run-1-recovered.mcap", "run-1.mcap"]


def test_no_place_is_taken_that_is_taken(cut: Path, tmp_path: Path) -> None:
    whole, _ = repaired(cut)
    shutil.copy(whole, tmp_path / "elsewhere.mcap")
    assert fullest(tmp_path / "elsewhere.mcap", []) == tmp_path / "elsewhere.mcap"
