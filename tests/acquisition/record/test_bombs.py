"""Small files that claim to hold gigabytes are left out or refused before they take the memory."""

import contextlib
import tracemalloc
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest

from acquisition.record.check import check_record
from acquisition.record.reader import RecordReader
from acquisition.record.recover import recover
from processing.errors import RecordError
from tests.acquisition.record.bombs import BOMBS, make_bomb

ALLOWED_BYTES = 200 * 1024 * 1024
CHEAP = ["six gigabytes", "false head", "large windows"]


@contextlib.contextmanager
def little_memory() -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < ALLOWED_BYTES
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module", params=CHEAP)
def bomb(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bomb") / "run.mcap"
    make_bomb(path, request.param)
    return path


def test_a_bomb_takes_no_memory(bomb: Path, tmp_path: Path) -> None:
    with little_memory():
        with RecordReader(bomb) as reader:
            assert len(reader.spots()) == 64
        assert any(finding.severity == "error" for finding in check_record(bomb))
        with contextlib.suppress(RecordError):
            recover(bomb, tmp_path / "copy.mcap")
        with contextlib.suppress(RecordError), RecordReader(bomb) as reader:
            assert sum(1 for _ in reader.windows()) == 64


def test_messages_of_nothing_are_counted_before_they_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make_bomb(path, "small chunks")
    with RecordReader(path) as reader:
        assert len(list(islice(reader.messages(), 10))) == 10
    make_bomb(path, "large messages")
    with RecordReader(path) as reader, pytest.raises(RecordError):
        list(reader.windows())


def test_more_than_a_measurement_can_unpack_to_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    make_bomb(path, "zeros")
    with pytest.raises(RecordError, match="unpack to more than can have been measured"):
        check_record(path)


def test_every_bomb_is_benchmarked() -> None:
    assert set(CHEAP) < set(BOMBS)
