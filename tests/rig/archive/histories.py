"""Random histories of an archive, against a model of twenty lines: what was seen last is what is listed."""

import contextlib
import datetime
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import patch

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from acquisition.record import whole_file
from acquisition.record.digest import sha256_of
from processing.errors import ConfigurationError
from rig.archive import add_sessions
from rig.archive.adding import session_folders
from rig.archive.store import Archive
from tests.acquisition.record.samples import write_sample

Row = tuple[str, str, str, str]
"""Computer, folder, name of the run, and what results say of it."""
COMPUTERS = ("one", "two")
PLACES = ("own-a", "own-b", "sub/c", "sub/d", "sub/e")
"""Folders below the root; both computers see all of them, as on a file server."""


class Model:
    """The present of a folder is what its computer saw last; a run is where it was seen last."""

    def __init__(self) -> None:
        self.seen = 0
        self.present: dict[tuple[str, str], tuple[int, dict[str, tuple[str, str]]]] = {}

    def add(self, computer: str, folders: dict[str, dict[str, tuple[str, str]]]) -> None:
        """A computer sees folders, in the order of their names, hold runs."""
        for folder in sorted(folders):
            self.seen += 1
            self.present[computer, folder] = (self.seen, folders[folder])

    def listed(self) -> dict[str, Row]:
        """Each run with the place where it was seen last."""
        found: dict[str, Row] = {}
        for (computer, folder), (_, runs) in sorted(self.present.items(), key=lambda item: item[1][0]):
            found |= {run: (computer, folder, *what) for run, what in runs.items()}
        return found


class Killed(BaseException):
    """Ends everything at once, as a kill does: nothing more is written."""


@contextlib.contextmanager
def killed_at(write: int) -> Iterator[None]:
    """From this write on no file is written any more."""
    count, write_new = 0, whole_file.write_new

    def writing(path: Path, data: bytes, **mode: int) -> None:
        nonlocal count
        count += 1
        if count >= write:
            raise Killed
        write_new(path, data, **mode)

    with patch.object(whole_file, "write_new", writing), contextlib.suppress(Killed):
        yield


class _Samples:
    """Small records, made once."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="samples-"))
        self.paths = []
        for number in range(5):
            path = self._folder / f"{number}.mcap"
            write_sample(path, 16 + number, seed=number, window_px=4)
            self.paths.append(path)
        self.sha256 = [sha256_of(path) for path in self.paths]

    def remove(self) -> None:
        shutil.rmtree(self._folder)


samples: list[_Samples] = []
states = st.tuples(st.integers(0, 2), st.sampled_from([None, 3, 4]), st.sampled_from([None, "A", "B"]))
places = st.sampled_from(PLACES)
computers = st.sampled_from(COMPUTERS)


class Histories(RuleBasedStateMachine):
    """Adds, moves, restores, withdrawals, clocks, kills, merges, two computers at once."""

    steps = 0
    """How often the list was compared."""

    def __init__(self) -> None:
        super().__init__()
        if not samples:
            samples.append(_Samples())
        self.base = Path(tempfile.mkdtemp(prefix="histories-"))
        self.root, self.archive = self.base / "runs", self.base / "archive"
        self.model = Model()
        self.year = 2026

    def teardown(self) -> None:
        shutil.rmtree(self.base)

    @initialize(state=states)
    def begin(self, state: tuple[int, int | None, str | None]) -> None:
        self.put(PLACES[0], state)

    @rule(place=places, state=states)
    def put(self, place: str, state: tuple[int, int | None, str | None]) -> None:
        """A session is measured, restored, extended, or its results are made or withdrawn."""
        folder = self.root / place
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        runs = []
        for name, number in (("run-1", state[0]), ("run-2", state[1])):
            if number is not None:
                # with the times that the files had, as a backup restores them
                shutil.copy2(samples[0].paths[number], folder / f"{name}.mcap")
                runs.append((f"{name}.mcap", samples[0].sha256[number]))
        if state[2] is not None:
            said = [{"record": name, "sha256": sha256, "problem": state[2]} for name, sha256 in runs]
            (folder / "results.json").write_text(json.dumps({"schema": 1, "runs": said}))

    @rule(a=places, b=places)
    def move(self, a: str, b: str) -> None:
        if (self.root / a).is_dir() and a != b:
            shutil.rmtree(self.root / b, ignore_errors=True)
            (self.root / b).parent.mkdir(parents=True, exist_ok=True)
            (self.root / a).rename(self.root / b)

    @rule(place=places)
    def remove(self, place: str) -> None:
        shutil.rmtree(self.root / place, ignore_errors=True)

    @rule(year=st.sampled_from([1971, 2025, 2026, 2041]))
    def set_clock(self, year: int) -> None:
        self.year = year

    @rule(computer=computers, place=st.sampled_from(["", "sub", *PLACES]), read=st.booleans())
    def add(self, computer: str, place: str, read: bool) -> None:
        if self.holds(place):
            self._on(computer, lambda: add_sessions(self.archive, [self.root / place], read=read))
            self.model.add(computer, self.holds(place))

    @rule(computer=computers, place=st.sampled_from(["", "sub"]), write=st.integers(1, 9))
    def add_killed(self, computer: str, place: str, write: int) -> None:
        """Nothing is lost, nothing invented, and the next one completes."""
        if not self.holds(place):
            return
        before = self.listed()
        with killed_at(write):
            self._on(computer, lambda: add_sessions(self.archive, [self.root / place]))
        after = Model()
        after.present, after.seen = dict(self.model.present), self.model.seen
        after.add(computer, self.holds(place))
        possible = {**before}
        for run, row in self.listed().items():
            places_of = [possible.get(run), *self._rows_of(after, run)]
            assert row in places_of, f"{run}: invented {row}"
        assert before.keys() - self.listed().keys() <= before.keys() - after.listed().keys(), "lost"
        self.add(computer, place, False)

    @rule()
    def add_at_once(self) -> None:
        """Two computers add the same folders at the same time; afterwards each once more."""
        if not self.holds(""):
            return

        def adding(computer: str) -> str:
            # the name is patched for both beforehand, by thread
            _names.current = computer
            return add_sessions(self.archive, [self.root])

        with patch("platform.node", lambda: _names.current), ThreadPoolExecutor(2) as two:
            list(two.map(adding, COMPUTERS))
        for computer in COMPUTERS:
            self.model.add(computer, self.holds(""))
        after = self.model
        for run, row in self.listed().items():
            assert row in self._rows_of(after, run)
        assert self.listed().keys() == after.listed().keys()
        for computer in COMPUTERS:
            self.add(computer, "", False)

    @rule()
    def merge(self) -> None:
        if self.model.present:
            Archive(self.archive).merge(at_once=1)

    @rule()
    def lose_what_is_derived(self) -> None:
        shutil.rmtree(self.archive / "merged", ignore_errors=True)

    @invariant()
    def list_is_as_the_model(self) -> None:
        Histories.steps += 1
        assert self.listed() == self.model.listed()

    def listed(self) -> dict[str, Row]:
        try:
            connection = Archive(self.archive).connection()
        except ConfigurationError:
            return {}
        question = "select sha256, computer, folder, run, coalesce(problem, '') from runs"
        return {
            run: (computer, Path(folder).relative_to(self.root).as_posix(), name, said)
            for run, computer, folder, name, said in connection.execute(question).fetchall()
        }

    def holds(self, place: str) -> dict[str, dict[str, tuple[str, str]]]:
        """What lies in the folders now, as the model wants it."""
        found = {}
        for folder in session_folders(self.root / place, self.archive):
            results = folder / "results.json"
            said = json.loads(results.read_text())["runs"][0]["problem"] if results.exists() else ""
            found[folder.relative_to(self.root).as_posix()] = {
                sha256_of(record): (record.stem, said) for record in folder.glob("*.mcap")
            }
        return found

    def _rows_of(self, model: Model, run: str) -> list[Row]:
        return [
            (computer, folder, *runs[run])
            for (computer, folder), (_, runs) in model.present.items()
            if run in runs
        ]

    def _on(self, computer: str, do: Callable[[], Any]) -> None:
        now = datetime.datetime(self.year, 1, 1)
        with (
            patch("platform.node", lambda: computer),
            patch("rig.archive.session_rows.now_utc", lambda: now),
        ):
            do()


class _Names:
    """Which computer a thread plays."""

    def __init__(self) -> None:
        import threading

        self._local = threading.local()

    @property
    def current(self) -> str:
        name: str = self._local.name
        return name

    @current.setter
    def current(self, name: str) -> None:
        self._local.name = name


_names = _Names()
