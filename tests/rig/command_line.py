"""The command line as `python -m rig` runs it, in the process of the tests."""

import contextlib
import io
import json
import logging
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import Mock, patch

from acquisition.record.reader import RecordReader
from processing.errors import DataError
from processing.fit import drag_verdict, identifiability
from rig.analysis import contact_verdicts
from rig.cli import main
from rig.report import html, session_report
from rig.report.drawing import png, svg
from rig.settings import Configuration, load_configuration

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
SAMPLES = Path(__file__).resolve().parent / "data" / "samples"
SMALL: dict[str, str] = {
    "simulation.sensor.width_px": "160",
    "simulation.sensor.height_px": "640",
    "camera.frame_rate_hz": "50",
}
"""A fifth of the demonstration's work a second, the same swing."""
QUICK: dict[str, str] = {**SMALL, "instrument.kind": '"tomlinson"', "session.max_duration_s": "24"}
"""A whole session, from frames to results and report, without the fit of a contact: an eighth of its work."""


AT_ONCE: dict[str, str] = {
    "start.way": '"at once"',
    "preflight.when": '"never"',
    "simulation.release.way": '"let go"',
}
"""A session that records from the first frame on."""


def set_words(values: dict[str, str]) -> list[str]:
    """Options that set these keys of the configuration."""
    return [word for key, value in values.items() for word in ("--set", f"{key}={value}")]


def configured(values: dict[str, str], source: Path = CONFIGS / "demo.toml") -> Configuration:
    """The configuration in a file with these keys set."""
    return load_configuration(source, [f"{key}={value}" for key, value in values.items()])


@dataclass(frozen=True)
class Done:
    """What a command left: its exit status and what it printed."""

    returncode: int
    stdout: str
    stderr: str


def rig(
    *words: str | Path,
    cwd: Path | None = None,
    figures: bool = False,
    typed: str = "",
    captured: bool = True,
) -> Done:
    """Run a command in this process, with `typed` as its input, which is no terminal.

    Where nothing is `captured`, it uses the streams that are there.

    Without `figures` the report has none: they take most of a short session's time, and are tested in a room
    of their own.
    """
    out, errors = io.StringIO(), io.StringIO()
    with (
        patch.object(sys, "argv", ["rig", *map(str, words)]),
        _streams(typed, out, errors) if captured else contextlib.nullcontext(),
        contextlib.chdir(cwd or Path.cwd()),
        _logging_of_its_own(),
        figures_are_drawn(figures),
    ):
        try:
            main()
        except SystemExit as end:
            status = end.code
    assert isinstance(status, int)
    return Done(status, out.getvalue(), errors.getvalue())


REAL_DRAWINGS = session_report._drawings


@contextlib.contextmanager
def figures_are_drawn(drawn: bool) -> Iterator[None]:
    """Whether a report is made with its figures, or with everything else."""
    with (
        patch.object(session_report, "_drawings", REAL_DRAWINGS if drawn else lambda *_: []),
        patch.multiple(
            html, svg=svg if drawn else lambda *_: b"<svg/>", png=png if drawn else lambda *_: b""
        ),
    ):
        yield


@contextlib.contextmanager
def verdicts_are_made(made: bool) -> Iterator[None]:
    """Whether fits say if a drag is seen and what is determined, which takes most of a short run's time."""
    left_out = Mock(side_effect=DataError("left out here"))
    with patch.multiple(
        contact_verdicts,
        drag_verdict=drag_verdict if made else left_out,
        identifiability=identifiability if made else left_out,
    ):
        yield


@contextlib.contextmanager
def _streams(typed: str, out: io.StringIO, errors: io.StringIO) -> Iterator[None]:
    with (
        patch.object(sys, "stdin", io.StringIO(typed)),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(errors),
    ):
        yield


@contextlib.contextmanager
def _logging_of_its_own() -> Iterator[None]:
    """The command finds the root logger as a new process has it, without the handlers of the test runner."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    root.handlers.clear()
    try:
        yield
    finally:
        root.handlers[:] = handlers
        root.setLevel(level)


def events_of(record: Path) -> list[tuple[str, str]]:
    """Kinds and texts of a whole record's events."""
    with RecordReader(record) as reader:
        assert not reader.truncated
        return [(event.kind, event.text) for event in reader.events()]


@dataclass(frozen=True)
class Session:
    """A session's folder, and what the command printed that measured there."""

    folder: Path
    done: Done = Done(0, "", "")

    @property
    def said(self) -> str:
        return self.done.stderr

    @property
    def record(self) -> Path:
        return self.folder / "run-1.mcap"

    @property
    def events(self) -> list[tuple[str, str]]:
        return events_of(self.record)

    @property
    def entries(self) -> list[dict[str, Any]]:
        """What the session's file says of each record."""
        return self._tree("session.json")["entries"]

    @property
    def runs(self) -> list[dict[str, Any]]:
        """The runs of its results."""
        return self._tree("results.json")["runs"]

    @property
    def audit(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (self.folder / "audit.jsonl").read_text("utf-8").splitlines()]

    def _tree(self, name: str) -> Any:
        return json.loads((self.folder / name).read_text("utf-8"))


def run(
    folder: Path, values: dict[str, str], *words: str | Path, config: str = "demo.toml", **changes: str
) -> Session:
    """`rig run` with these keys of a configuration set, also as `section__key`."""
    values = {**values, **{key.replace("__", "."): value for key, value in changes.items()}}
    return Session(folder, rig("run", CONFIGS / config, "-o", folder, *words, *set_words(values)))
