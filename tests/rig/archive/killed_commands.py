"""Commands of an archive killed at every moment: nothing is lost, nothing invented, the next one completes.

A command runs in a process of its own that ends itself, as a kill does, at one of its calls that change
a file, or at one of its requests to where a remote archive lies.
"""

import contextlib
import datetime
import importlib.util
import json
import os
import random
import shutil
import signal
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

from acquisition.record.reader import RecordReader
from acquisition.record.repaired import repaired
from rig.archive import add_sessions, blind_runs, remark, thin_runs
from rig.archive.bucket import Bucket
from rig.archive.checking import check_archive
from rig.archive.refits import Recipe, Task, code_identity, refit
from rig.archive.remote import opened
from rig.archive.store import Archive
from rig.sealing import seal_over

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"
_CALLS = ("fsync", "link", "replace", "rename", "write", "unlink", "remove", "mkdir", "open")
_REQUESTS = ("names", "read", "create", "overwrite", "take_away", "try_to_write_over")
_ENDED_NORMALLY = 0
_STAYS = ".seen"
"""Of a copy of a remote archive."""


class Command(NamedTuple):
    """A command to be killed, and what is said of the folder afterwards; `prepare` comes before both."""

    name: str
    prepare: Callable[[Path], None]
    run: Callable[[Path], object]
    look: Callable[[Path], object]


@contextlib.contextmanager
def _dying(at: int, count_to: Path | None) -> Iterator[None]:
    """End this process at its call of this number; write how many there were."""
    count = 0

    def dying(call: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*words: Any, **named: Any) -> Any:
            nonlocal count
            count += 1
            if count == at:
                os.kill(os.getpid(), signal.SIGKILL)
            return call(*words, **named)

        return wrapped

    for name in _CALLS:
        setattr(os, name, dying(getattr(os, name)))
    for name in _REQUESTS:
        setattr(Bucket, name, dying(getattr(Bucket, name)))
    yield
    if count_to is not None:
        count_to.write_text(str(count))


def _in_child(do: Callable[[], object], *, at: int = 0, told: Path) -> bool:
    """Do it in a process of its own; whether it ended normally. `told`: what it returned, or its calls."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            sink = os.open(os.devnull, os.O_WRONLY)
            os.dup2(sink, 1)
            os.dup2(sink, 2)
            if at >= 0:
                with _dying(at, told):
                    do()
            else:
                told.write_text(json.dumps(do(), default=str))
            code = _ENDED_NORMALLY
        finally:
            os._exit(code)
    return os.waitpid(child, 0)[1] == 0


def _asked(do: Callable[[], object], told: Path) -> Any:
    assert _in_child(do, at=-1, told=told), "it cannot be read"
    return json.loads(told.read_text())


def kills(count: int, *, names: tuple[str, ...] = ()) -> dict[str, Any]:
    """Each command killed at moments spread over all of its calls."""
    chosen = [command for command in commands() if not names or command.name in names]
    each = -(-count // len(chosen))
    found: dict[str, Any] = {}
    wrong: list[str] = []
    total = 0
    for command in chosen:
        with (
            tempfile.TemporaryDirectory() as name,
            # where the keys of what is hidden lie
            patch.dict(os.environ, {"XDG_DATA_HOME": f"{name}/data"}),
        ):
            done, calls, faults = _killed(command, each, Path(name))
        total += done
        wrong += faults
        found[f"kills: {command.name}"] = f"{done} of {calls} calls"
        print(f"  kills: {command.name}: {done} of {calls} calls, {len(faults)} wrong", flush=True)
    return {**found, "kills": total, "kills: wrong": len(wrong), "kills: which": wrong[:20]}


def _killed(command: Command, each: int, base: Path) -> tuple[int, int, list[str]]:
    """One command: how often it was killed, how many calls it has, and what was not as it should be."""
    told, place, start = base / "told", base / "place", base / "start"
    place.mkdir()
    assert _in_child(lambda: command.prepare(place), told=told)
    # the copy has the times of the files, by which sessions are known
    shutil.copytree(place, start)
    before = _asked(lambda: command.look(place), told)
    assert _in_child(lambda: command.run(place), told=told)
    calls = int(told.read_text())
    after = _asked(lambda: command.look(place), told)
    done, wrong = 0, list[str]()
    for at in sorted(random.Random(5).sample(range(1, calls + 1), min(each, calls))):
        shutil.rmtree(place)
        shutil.copytree(start, place)
        done += not _in_child(lambda: command.run(place), at=at, told=told)
        what = _asked(lambda: command.look(place), told)
        if what not in (before, after) and not _between(before, what, after):
            wrong.append(f"{command.name} at {at}: neither before nor after: {what}")
        if not _in_child(lambda: command.run(place), told=told):
            wrong.append(f"{command.name} at {at}: the next one fails")
        elif _asked(lambda: command.look(place), told) != after:
            wrong.append(f"{command.name} at {at}: the next one does not complete")
        left = [path.name for path in place.rglob(".*") if path.name != _STAYS]
        if left:
            wrong.append(f"{command.name} at {at}: left {left}")
    return done, calls, wrong


def _between(before: Any, what: Any, after: Any) -> bool:
    """Of rows: each is as it was or as it will be, and what is to stay is there.

    A command that takes long, as on a busy machine, says of some sessions before others what it saw.
    """
    if not all(isinstance(rows, list) for rows in (before, what, after)):
        return False
    return all(row in before or row in after for row in what) and all(
        row in what for row in before if row in after
    )


def commands() -> list[Command]:
    """Those that change an archive or a record."""
    rule = {"drop_after": 0, "recompress_after": None}
    today = datetime.date(2027, 11, 22)

    def sessions(base: Path) -> None:
        for name in ("series", "uncalibrated"):
            shutil.copytree(SAMPLES / name, base / "runs" / name)

    def added(base: Path) -> None:
        sessions(base)
        add_sessions(base / "archive", [base / "runs"])

    def add(base: Path) -> None:
        add_sessions(base / "archive", [base / "runs"])
        Archive(base / "archive").merge(at_once=1)

    def withdrawn(base: Path) -> None:
        added(base)
        (base / "runs" / "series" / "results.json").unlink()

    def refitted(base: Path) -> None:
        archive = Archive(base / "archive")
        question = "select sha256 from runs where folder like '%uncalibrated'"
        (sha256,) = archive.connection().execute(question).fetchone()
        recipe = Recipe("swings", (), (), code_identity())
        record = base / "runs" / "uncalibrated" / "run-1.mcap"
        said = refit(Task(str(base / "archive"), record, sha256, recipe, 1))
        assert not said
        archive.refits.merge(at_once=1)

    def thinned(base: Path) -> None:
        thin_runs(base / "archive", [], "run = 'run-1'", **rule, agreed=lambda question: True, today=today)
        add_sessions(base / "archive", [base / "runs"])

    def damaged(base: Path) -> None:
        added(base)
        Archive(base / "archive").merge(at_once=1)
        for path in (base / "archive" / "merged").iterdir():
            path.write_bytes(path.read_bytes()[:-9])

    def cut(base: Path) -> None:
        sessions(base)

    def tagged(base: Path) -> None:
        if "good" not in str(_runs(base)):
            remark(base / "archive", [], "true", add="good")
        add_sessions(base / "archive", [base / "runs"])

    def blinded(base: Path) -> None:
        blind_runs(base / "archive", ["b"], [base / "runs"])
        add_sessions(base / "archive", [base / "runs"])

    def sent(base: Path) -> None:
        with _remote(base, base / "cache") as archive:
            add_sessions(archive, [base / "runs"])

    def prepared_remote(base: Path) -> None:
        (base / "bucket").mkdir()
        sessions(base)

    def sent_before(base: Path) -> None:
        prepared_remote(base)
        sent(base)

    def withdrawn_remote(base: Path) -> None:
        sent_before(base)
        (base / "runs" / "series" / "results.json").unlink()

    def tag_sent(base: Path) -> None:
        with _remote(base, base / "cache") as archive:
            if "good" not in str(_runs_of(archive)):
                remark(archive, [], "true", add="good")

    remote = [
        Command("add, remote", prepared_remote, sent, _runs_there),
        Command("add again, remote", withdrawn_remote, sent, _runs_there),
        Command("tag, remote", sent_before, tag_sent, _runs_there),
    ]
    if importlib.util.find_spec("fsspec") is None:
        remote = []
    return [
        Command("add", sessions, add, _runs),
        Command("add again", withdrawn, add, _runs),
        Command("refit", added, refitted, lambda base: _runs(base, refits=True)),
        Command("thin", added, thinned, _windows),
        Command("tag", added, tagged, _runs),
        Command("blind", added, blinded, _seals),
        Command(
            "check --repair", damaged, lambda base: check_archive(base / "archive", repair=True), _states
        ),
        Command("recover", cut, lambda base: repaired(base / "runs" / "series" / "run-2.mcap"), _copies),
        *remote,
    ]


@contextlib.contextmanager
def _remote(base: Path, cache: Path) -> Iterator[Path]:
    """An archive that lies where fsspec reaches it, with its copy in a cache."""
    import fsspec

    with (
        # as a bucket, which has no folders to be made
        patch.dict(fsspec.config.conf, {"file": {"auto_mkdir": True}}),
        patch.dict(os.environ, {"XDG_CACHE_HOME": str(cache)}),
        opened((base / "bucket" / "archive").as_uri()) as archive,
    ):
        yield archive


def _runs_there(base: Path) -> object:
    """What somebody sees who has no copy yet."""
    if not (base / "bucket" / "archive").exists():
        return []
    with tempfile.TemporaryDirectory() as cache, _remote(base, Path(cache)) as archive:
        return _runs_of(archive)


def _runs(base: Path, *, refits: bool = False) -> object:
    return _runs_of(base / "archive", refits=refits)


def _runs_of(folder: Path, *, refits: bool = False) -> object:
    archive = Archive(folder)
    try:
        connection = archive.connection(refits=refits)
    except Exception as error:
        if "holds no sessions" in str(error):
            return []
        raise
    table, more = ("refits", "problem") if refits else ("runs", "results")
    question = f"select sha256, run, state, b, tags, {more} from {table} order by all"
    return connection.execute(question).fetchall()


def _states(base: Path) -> object:
    return sorted(path.name for path in (base / "archive" / "sessions").iterdir())


def _windows(base: Path) -> object:
    """The record itself: it is one of the two."""
    with RecordReader(base / "runs" / "series" / "run-1.mcap") as reader:
        return [len(list(reader.windows())), len(reader.spots()), not reader.doubts()]


def _copies(base: Path) -> object:
    found = []
    for path in sorted((base / "runs" / "series").glob("run-2-*.mcap")):
        with RecordReader(path) as reader:
            found.append([path.name, len(reader.spots()), reader.truncated])
    return found


def _seals(base: Path) -> object:
    from rig.archive.blind import sealed

    found, folder = sealed(base / "archive"), seal_over(base / "runs")
    # the folder comes first: killed before the archive is sealed, it is blind already
    if found is None:
        return False
    assert folder is not None, "the archive is blind, and its folder is not"
    assert folder.public_key == found.public_key
    return sorted(found.scales)
