"""The wizards of the calibrations as the desk has them: their answers in files, what is being recorded."""

import time
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

from processing.errors import ConfigurationError, RigError
from rig.calibrate import Filing
from rig.desk.jobs import Job
from rig.wizards import (
    KINDS,
    CalibrationWizard,
    Draft,
    Filed,
    Progress,
    answered,
    as_far_as_it_holds,
    calibration_wizard,
    drop_draft,
    filed,
    keep_draft,
    kept_draft,
    place_for,
    progress,
)

if TYPE_CHECKING:
    from rig.desk.desk import Desk

FOLDER = Path("calibrations")


class Calibrating:
    """All wizards of a desk. Their answers are the files that `rig calibrate` keeps in `FOLDER`, too.

    `made` are the calibrations filed at this desk, `problems` what went wrong last, both by kind.
    """

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk
        self._recording: dict[str, tuple[Path, Job]] = {}
        self._wanted_s: dict[str, float | None] = {}
        self._begun_s: dict[str, float] = {}
        self.made: dict[str, Filed] = {}
        self.problems: dict[str, str] = {}

    def wizard(self, kind: str) -> CalibrationWizard:
        """The wizard of a kind."""
        return calibration_wizard(kind, self._desk.config)

    def draft(self, kind: str) -> Draft:
        """The answers so far; raises RigError for a file that holds something else."""
        return as_far_as_it_holds(self.wizard(kind), kept_draft(_kept(kind)))

    def progress(self, kind: str) -> Progress:
        """Where the wizard stands."""
        return progress(self.wizard(kind), self.draft(kind))

    def answer(self, kind: str, text: str) -> None:
        """Take one answer; raises RigError, one line, for one that cannot be."""
        keep_draft(_kept(kind), answered(self.wizard(kind), self.draft(kind), text))
        self.problems.pop(kind, None)

    def back(self, kind: str) -> None:
        """One question back."""
        keep_draft(_kept(kind), self.draft(kind).without_last())
        self.problems.pop(kind, None)

    def record(self, kind: str) -> None:
        """Record what is asked for, by `rig camera record` or `frames`; what was recorded is the answer.

        May wait until the camera is free.
        """
        question = self.progress(kind).question
        wanted = None if question is None else question.recording
        if wanted is None:
            raise ConfigurationError("there is nothing to record here")
        path = place_for(wanted, FOLDER)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.problems.pop(kind, None)
        if wanted.kind == "record":
            words = ["camera record", "-o", str(path), "--seconds", f"{wanted.seconds:g}"]
            values = {}
        else:
            words = ["camera frames", "-o", str(path), "-n", str(wanted.frames)]
            values = {} if wanted.exposure_us is None else {"camera.exposure_us": wanted.exposure_us}
        self._wanted_s[kind] = wanted.seconds if wanted.kind == "record" else None
        self._begun_s.pop(kind, None)
        self._recording[kind] = path, self._desk.start(*words, values=values)

    def stop(self, kind: str) -> None:
        """End the recording, and darken; what was not recorded to its end is no answer."""
        if kind in self._recording:
            self._recording[kind][1].end()

    def recording(self, kind: str) -> str:
        """What is being recorded; empty if nothing is.

        What was recorded becomes the answer here.
        """
        if kind not in self._recording:
            return ""
        path, job = self._recording[kind]
        if job.status is None:
            return f"{path} is recorded"
        del self._recording[kind]
        if job.status == 0 and not job.ending:
            try:
                self.answer(kind, str(path))
            except RigError as error:
                self.problems[kind] = str(error)
        elif job.ending:
            self.problems[kind] = "the recording was stopped"
        else:
            self.problems[kind] = job.said[-1].removeprefix("rig: ") if job.said else "it was not recorded"
        return ""

    def recorded_part(self, kind: str) -> float | None:
        """Part of the time that has passed of what is recorded; None where nothing says how long it takes.

        It counts from when the file is there: until then the camera is opened.
        """
        wanted_s = self._wanted_s.get(kind)
        if not wanted_s or kind not in self._recording:
            return None
        if kind not in self._begun_s and not self._recording[kind][0].exists():
            return 0.0
        begun_s = self._begun_s.setdefault(kind, time.monotonic())
        return min((time.monotonic() - begun_s) / wanted_s, 1.0)

    def last_words(self, kind: str) -> str:
        """What the command that records has said last; empty if nothing is recorded."""
        said = self._recording[kind][1].said if kind in self._recording else ()
        return said[-1] if said else ""

    @property
    def watched(self) -> Path | None:
        """The record that is being made, whose order socket shows how it looks; None while none is."""
        running = [path for path, job in tuple(self._recording.values()) if job.running and path.suffix]
        return running[0] if running else None

    def start_over(self, kind: str) -> None:
        """Forget the answers; what was recorded stays."""
        self.stop(kind)
        drop_draft(_kept(kind))
        self.problems.pop(kind, None)

    def use(self, kind: str) -> str:
        """The calibration made last holds for all that this desk starts; returns what to state for good."""
        made = self.made.get(kind)
        if made is None:
            raise ConfigurationError(f"no calibration of the {kind} was made here yet: answer, then file it")
        (table, keys), *_ = tomllib.loads(made.configuration).items()
        own = {f"{table}.{key}": _from_anywhere(stated) for key, stated in keys.items()}
        self._desk.checked(own)
        self._desk.kept.update(own)
        return made.configuration.replace("\n", "  ")

    def file(self, kind: str, filing: Filing) -> None:
        """Make the calibration and file it; takes seconds.

        Raises RigError where the measurement does not serve; the last question is then asked again.
        """
        found = self.progress(kind)
        if found.question is not None:
            raise ConfigurationError(f"not everything is answered: {found.question.text}")
        try:
            self.made[kind] = filed(self.wizard(kind).file(found.values, filing))
        except RigError as error:
            self.problems[kind] = str(error)
            keep_draft(_kept(kind), self.draft(kind).without_last())
            raise
        drop_draft(_kept(kind))
        self.problems.pop(kind, None)


def _from_anywhere(stated: object) -> object:
    """Paths of this folder as they are found from any other."""
    if isinstance(stated, list):
        return [_from_anywhere(one) for one in stated]
    return Path(str(stated)).absolute().as_posix()


def _kept(kind: str) -> Path:
    if kind not in KINDS:
        raise ConfigurationError(f"{kind!r}: no such calibration; there are {', '.join(KINDS)}")
    return FOLDER / f"{kind}-answers.json"
