"""A file that is not a record gives one clear line, and no file is written."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
from mcap.writer import Writer

from acquisition.record import pixels_path
from acquisition.record.check import check_record, recover
from acquisition.record.reader import RecordReader
from acquisition.record.topics import METADATA_COPY, SCHEMA_VERSION
from acquisition.record.writer import RecordWriter
from processing.errors import RecordError
from tests.acquisition.record.samples import write_sample


@contextmanager
def mcap(path: Path) -> Iterator[Writer]:
    """An MCAP file of another program, or of another version of this one."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        yield writer
        writer.finish()


def foreign(path: Path) -> None:
    with mcap(path) as writer:
        schema = writer.register_schema("Pose", "jsonschema", b"{}")
        channel = writer.register_channel("/robot/pose", "json", schema)
        writer.add_message(channel, 1, b"{}", 1)


def empty_mcap(path: Path) -> None:
    with mcap(path):
        pass


def of_schema(version: str, path: Path) -> None:
    identity = json.dumps({"record": {"schema_version": version, "epoch_offset_ns": "0"}}).encode()
    with mcap(path) as writer:
        writer.add_attachment(0, 0, METADATA_COPY, "application/json", identity)


def cut_in_its_head(path: Path) -> None:
    write_sample(path, 16)
    path.write_bytes(path.read_bytes()[:40])


NEWER = str(SCHEMA_VERSION + 1)
CASES = {
    "no such file": (lambda path: None, "no such record; .* has no record; give the path of one"),
    "folder": (Path.mkdir, "cannot be read"),
    "empty": (Path.touch, "is empty"),
    "text": (lambda path: path.write_text("t,x\n1,2\n"), "is not an MCAP file"),
    "magic alone": (
        lambda path: path.write_bytes(b"\x89MCAP0\r\n"),
        "cut short before anything was recorded",
    ),
    "foreign": (foreign, r"another program \(topics: /robot/pose\)"),
    "empty MCAP": (empty_mcap, r"another program \(topics: none\)"),
    "newer": (
        partial(of_schema, NEWER),
        f"is of schema {NEWER}; this version reads schema {SCHEMA_VERSION}",
    ),
    "own description damaged": (partial(of_schema, "one"), "its own description is damaged"),
    "cut in its head": (cut_in_its_head, "cut short before anything was recorded"),
}
if hasattr(os, "mkfifo"):
    # opening one would wait for a writer for ever
    CASES["pipe"] = (os.mkfifo, "is not a file but a pipe or device")


@pytest.mark.parametrize("case", CASES)
def test_one_clear_line(tmp_path: Path, case: str) -> None:
    make, expected = CASES[case]
    path = tmp_path / "file.mcap"
    make(path)
    before = sorted(tmp_path.iterdir())
    copy = tmp_path / "whole.mcap"
    for use in (RecordReader, check_record, lambda path: recover(path, copy)):
        with pytest.raises(RecordError, match=expected) as caught:
            use(path)
        assert "\n" not in str(caught.value)
        assert str(path) in str(caught.value)
    assert sorted(tmp_path.iterdir()) == before


def test_a_file_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_sample(path, 16)
    before = path.read_bytes()
    with pytest.raises(RecordError, match="never overwritten"):
        RecordWriter(path, 0)
    with pytest.raises(RecordError, match="never overwritten"):
        recover(path, path)
    assert path.read_bytes() == before
    pixels_path(path).rename(tmp_path / "other.pixels.mcap")
    with pytest.raises(RecordError, match=r"other\.pixels\.mcap: exists already and is never overwritten"):
        RecordWriter(tmp_path / "other.mcap", 0)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["other.pixels.mcap", "run.mcap"]


def test_a_folder_that_does_not_exist_is_said(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="cannot be created: No such file"):
        RecordWriter(tmp_path / "missing" / "run.mcap", 0)


def test_results_that_are_none_are_said(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    write_sample(path, 16)
    results = tmp_path / "results.json"
    with pytest.raises(RecordError, match="cannot be read"):
        check_record(path, results)
    results.write_text("[1]")
    with pytest.raises(RecordError, match=r"is not a results\.json"):
        check_record(path, results)
