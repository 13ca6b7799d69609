"""The processes that the desk starts: sessions, commands that end with the desk, `rig balance`."""

import json
import subprocess
import threading
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from processing.errors import ConfigurationError
from rig.interruption import start_python
from rig.prepare import BalanceDialogue, BalanceStage, balance_dialogue

if TYPE_CHECKING:
    from rig.desk.desk import Desk


_MAX_OUTPUT_LINES = 200
_MAX_OBJECTS = 2000
"""Number of JSON objects that are kept: a measurement of the balance with its whole path."""
_READ_WITHIN_S = 2.0
MESSAGES_NAME = "messages.txt"


class StartedSession(NamedTuple):
    """A session that the desk has started, and that goes on when the desk ends."""

    process: "subprocess.Popen[bytes]"
    folder: Path

    @property
    def status(self) -> int | None:
        """Exit status of its process; None while it runs."""
        return self.process.poll()


def start_session(words: list[str], folder: Path) -> StartedSession:
    """Start a session; what it prints is added to a file in `folder`."""
    null = subprocess.DEVNULL
    with (folder / MESSAGES_NAME).open("ab") as messages:
        process = start_python("-m", "rig", *words, stdin=null, stdout=messages, stderr=messages)
    return StartedSession(process, folder)


def failure_reason(printed: Iterable[str], status: int | None) -> str:
    """Why a command has ended with an error, by the lines that it has printed and its exit status."""
    lines = [line for line in printed if line.strip()]
    # lines on the light follow that of the error
    errors = [line.removeprefix("rig: ") for line in lines if line.startswith("rig: ")]
    return (errors or lines or [f"ended with status {status}"])[-1]


class Job:
    """A command that ends with the desk, because its pipes do; it answers in JSON lines.

    While a command that `uses_camera` runs, no other has the camera, and LIGHT OFF ends it.
    """

    def __init__(self, words: list[str], *, uses_camera: bool = False) -> None:
        pipe = subprocess.PIPE
        self._process = start_python(
            "-m", "rig", *words, stdin=pipe, stdout=pipe, stderr=pipe, text=True, encoding="utf-8"
        )
        self.uses_camera = uses_camera
        self.end_requested = False
        self.lines: deque[dict[str, Any]] = deque(maxlen=_MAX_OBJECTS)
        """The last JSON objects that it printed, and the answers that it was given."""
        self.newest: dict[str, dict[str, Any]] = {}
        """The last JSON object of each kind."""
        self.output: deque[str] = deque(maxlen=_MAX_OUTPUT_LINES)
        """The other lines that it printed."""
        self._answer_lock = threading.Lock()
        self._readers = [
            threading.Thread(target=target, name=f"job-{words[0]}", daemon=True)
            for target in (self._read_stdout, self._read_stderr)
        ]
        for reader in self._readers:
            reader.start()

    @property
    def running(self) -> bool:
        return self.status is None

    @property
    def status(self) -> int | None:
        """Its exit status; None while it runs."""
        return self._process.poll()

    @property
    def problem(self) -> str:
        return failure_reason(self.output, self.status)

    def wait(self, limit_s: float | None = None) -> bool:
        """Wait for its end; returns whether it ended within the limit, with all that it printed read."""
        try:
            self._process.wait(limit_s)
        except subprocess.TimeoutExpired:
            return False
        for reader in self._readers:
            reader.join(_READ_WITHIN_S)
        return True

    @property
    def asks(self) -> bool:
        """Whether it waits for an answer."""
        return bool(self.lines) and self.lines[-1].get("kind") == "ask"

    def answer(self, text: str) -> None:
        """Answer its question by a line on its standard input; without effect if it asks nothing.

        A second answer to one question, by a double click or from another tab, would answer the next one.
        """
        with self._answer_lock, suppress(OSError, ValueError):
            if self.asks and self._process.stdin is not None:
                self.lines.append({"kind": "answer", "text": text})
                self._process.stdin.write(f"{text}\n")
                self._process.stdin.flush()

    def end(self) -> None:
        """Interrupt it as Ctrl-C does: it switches off what it has switched on."""
        self.end_requested = True
        with suppress(OSError):
            self._process.terminate()

    def kill(self) -> None:
        """Kill it, if it cannot be interrupted; the caller must have switched off its light."""
        self._process.kill()
        self._process.wait()

    def _read_stdout(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                try:
                    content = json.loads(line)
                except ValueError:
                    self.output.append(line.rstrip())
                    continue
                if isinstance(content, dict):
                    # a command that prints a single object names no kind
                    content = {"kind": "result", **content}
                    self.lines.append(content)
                    self.newest[str(content["kind"])] = content
        with suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()

    def _read_stderr(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as lines:
            for line in lines:
                self.output.append(line.rstrip())


class Jobs(dict[str, Job]):
    """The commands that a desk has started, the last one of each name."""

    def begin(self, name: str, *words: str, uses_camera: bool = False) -> Job:
        """Start `rig NAME`; raises ConfigurationError while an earlier command of this name runs."""
        if self.running_job(name) is not None:
            raise ConfigurationError(f"rig {name} still runs; wait, or end it first")
        self[name] = Job([*name.split(), *words], uses_camera=uses_camera)
        return self[name]

    def running_job(self, name: str) -> Job | None:
        """The command of this name that runs now; None without one."""
        job = self.get(name)
        return job if job is not None and job.running else None

    def running(self, *, uses_camera: bool) -> list[tuple[str, Job]]:
        """Names and commands that run now and use the camera, or do not use it."""
        return [
            (name, job) for name, job in tuple(self.items()) if job.uses_camera is uses_camera and job.running
        ]


_NAME = "balance"
_MEASURE, _FORGET, _END = "m", "f", "q"
"""Answers that the command takes between two measurements, besides a turn."""


class Balancing:
    """Balancing at one desk, by the command `rig balance`."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk

    @property
    def running(self) -> bool:
        """Whether the command measures, or waits for a turn."""
        return self._job is not None

    @property
    def dialogue(self) -> BalanceDialogue:
        job = self._desk.jobs.get(_NAME)
        if job is None:
            return BalanceDialogue(BalanceStage.IDLE, "Measure: let the pendulum swing, not too far")
        failed = bool(job.status) and not job.end_requested
        return balance_dialogue(list(job.lines), list(job.output), running=job.running, failed=failed)

    def measure(self) -> None:
        """Measure, or measure again; may wait for the camera."""
        job = self._job
        if job is None:
            words = ["--seed", "1"] if self._desk.config.simulated else []
            self._desk.start(_NAME, "--json", *words)
        elif job.asks:
            job.answer(_MEASURE)

    def state_turn(self, weight: str, turns: str) -> None:
        """State the turns of a weight; their effect is measured next."""
        job = self._job
        if job is None or not job.asks:
            raise ConfigurationError("first measure: a turn is stated between two measurements")
        job.answer(f"{weight} {turns.strip()}")

    def forget(self) -> None:
        """Take the last turn back; the dialogue says which. May wait for the camera."""
        job = self._job
        if job is None:
            self._desk.start(_NAME, "--forget-last", "--json")
        elif not job.asks:
            raise ConfigurationError("wait for the end of the measurement")
        else:
            job.answer(_FORGET)

    def end(self) -> None:
        """End the command; a measurement that is not finished is discarded."""
        job = self._job
        if job is None:
            return
        if job.asks:
            job.answer(_END)
            job.end_requested = True
        else:
            job.end()

    @property
    def _job(self) -> Job | None:
        return self._desk.jobs.running_job(_NAME)
