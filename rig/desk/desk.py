"""State that all tabs of the desk share: configuration, running session, started commands."""

import os
import signal
import subprocess
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from calibration import toml_value
from processing.errors import ConfigurationError, RigError
from rig.control import SafetyState, darken_directly, rig_state_path
from rig.desk.alarming import Alarming
from rig.desk.following import Following
from rig.desk.jobs import MESSAGES_NAME, Balancing, Job, Jobs, reason_in, start_session
from rig.desk.lighting import Lighting, Safety
from rig.desk.sessions import SessionIndex, last_summary
from rig.desk.store import DeskStore
from rig.devices import NoSession
from rig.instrument import complete
from rig.measure import SessionSummary, session_folder
from rig.settings import Configuration, load_configuration

_ENDS_WITHIN_S = 5.0
_WAKES_WITHIN_S = 10.0
"""Time within which a process that was stopped (Ctrl-Z) and continued answers again, or has ended."""
_LOOK_S = 0.1
_CLOSES_WITHIN_S = 10.0
_ALIGN = "camera align"
_REGION = ("width_px", "height_px", "offset_x_px", "offset_y_px")


class Desk:
    """The desk of one configuration file; `overrides` are as of --set, and hold for all that it starts.

    `kept` are settings that were made at the desk (exposure, region), by key: they hold as long as it does.
    `place` is what is kept on disk, `lighting` takes light and gives it, `rig` is the rig's own safety state.
    `archive` is the file whose runs are listed, too; `started` are the process and the folder of the session
    that was started here last.
    """

    def __init__(self, source: Path, overrides: tuple[str, ...] = (), archive: Path = Path()) -> None:
        self.source = source
        self.archive = archive
        self._overrides = overrides
        self.kept: dict[str, object] = {}
        self.config = load_configuration(source, overrides)
        self.balancing = Balancing(self)
        self.following = Following(self.config.session.output, self._rig_holder)
        self.rig = SafetyState(rig_state_path(self.config.laser, self.config.controller))
        by = "board" if self.config.laser.kind == "controller" else "laser"
        self.jobs = Jobs()
        self.safety = Safety(self.rig, self.following, by)
        self.sessions = SessionIndex(self.config.session.output)
        self.started: tuple[subprocess.Popen[bytes], Path] | None = None
        self.place = DeskStore(source)
        self.alarming = Alarming(self)
        self.lighting = Lighting(self)
        self._lock = threading.Lock()

    # -- the configuration ------------------------------------------------------

    def overridden(self, values: Mapping[str, object] | None = None) -> list[str]:
        """KEY=VALUE of everything that differs from the file, `values` last."""
        own = {**self.kept, **(values or {})}
        stated = [one for one in self._overrides if one.partition("=")[0].strip() not in own]
        return [*stated, *(f"{key}={toml_value(value)}" for key, value in own.items())]

    def _sets(self, values: Mapping[str, object] | None) -> list[str]:
        return [word for one in self.overridden(values) for word in ("--set", one)]

    def checked(self, values: Mapping[str, object] | None = None) -> Configuration:
        """The configuration with `values` changed; raises ConfigurationError with the models' own words."""
        return load_configuration(self.source, self.overridden(values))

    # -- what is started --------------------------------------------------------

    def start(self, name: str, *words: str) -> Job:
        """Start a command of this configuration that uses the camera, and ends with the desk.

        It shows its light in the folder of the sessions. Raises ConfigurationError where the camera is in
        use, or a trip is not acknowledged. May wait.
        """
        self._needs_rig(name)
        with suppress(OSError):
            # without it a rig whose laser is not switched shows no picture
            self.config.session.output.mkdir(parents=True, exist_ok=True)
        return self.jobs.begin(name, str(self.source), *words, *self._sets(None), uses_camera=True)

    def start_session(self, values: Mapping[str, object], *, force: bool = False) -> Path:
        """Start `rig run` with these values; it goes on when the desk ends. Returns the session's folder."""
        with self._lock:
            self._needs_rig("run")
            config = self.checked(values)
            folder, _ = session_folder(config, self.source, None)
            words = ["run", str(self.source), "-o", str(folder), *self._sets(values)]
            self.started = start_session([*words, "--force"] if force else words, folder), folder
        self.following.look_now(folder)
        return folder

    def resume_session(self, folder: Path) -> None:
        """Start `rig run --resume`; it goes on when the desk ends."""
        with self._lock:
            self._needs_rig("run")
            self.started = start_session(["run", "--resume", str(folder)], folder), folder
        self.following.look_now(folder)

    def stop_session(self, wakes_within_s: float = _WAKES_WITHIN_S) -> str:
        """Stop the session, which may be frozen; returns what was done. May wait.

        A frozen one hears no order: its light is switched off at the ports, then its process is told to end,
        and to go on if somebody has stopped it: it closes its record, if it can. What does neither is killed.
        Raises RigError where it cannot be stopped.
        """
        following = self.following
        if not following.frozen:
            return following.order("stop")
        process = following.process
        if process is None:
            raise NoSession("the session does not answer, and its process is not known; end it by hand")
        problems = darken_directly(self.config.laser, self.config.controller)
        lit = f"; the laser may be lit: {'; '.join(problems)}" if problems else ""
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGTERM)
            if hasattr(signal, "SIGCONT"):
                # Ctrl-Z stops its helpers, too
                os.killpg(os.getpgid(process), signal.SIGCONT)
            deadline_s = time.monotonic() + wakes_within_s
            while following.frozen and time.monotonic() < deadline_s:
                time.sleep(_LOOK_S)
            if not following.frozen:
                return f"the session was frozen; its process ends, and closes its record if it can{lit}"
            os.kill(process, getattr(signal, "SIGKILL", signal.SIGTERM))
        return f"the session was frozen; its process was killed, Resume measures the missing runs{lit}"

    def needs_camera(self, who: str) -> None:
        """Give the camera free; raises ConfigurationError if a session or a command keeps it. May wait.

        A session that was stopped, and a command that has reported its result, still close their devices.
        """
        self.end_aligning()
        deadline_s = time.monotonic() + _ENDS_WITHIN_S
        while holder := self._camera_holder():
            if time.monotonic() > deadline_s:
                raise ConfigurationError(
                    f"rig {who} needs the camera, which {holder} has; wait, or end it first"
                )
            time.sleep(_LOOK_S)

    def _camera_holder(self) -> str:
        """What has the camera, but for the live picture; empty if nothing has it."""
        if self.following.running or self.start_runs:
            return "a session"
        return next((f"rig {name}" for name, _ in self.jobs.running(uses_camera=True)), "")

    def _needs_rig(self, who: str) -> None:
        """Give the camera free; raises ConfigurationError while a trip is latched. May wait."""
        if (trip := self.safety.trip) is not None:
            raise ConfigurationError(f"rig {who} is not started: {trip.text}; acknowledge it first")
        self.needs_camera(who)

    def begin_aligning(self) -> None:
        """Start the live picture. May wait."""
        config = complete(self.checked())
        self.start(_ALIGN)
        self.following.look_now(stated=config)

    @property
    def live_picture(self) -> Job | None:
        """The command of the live picture that runs; None without one."""
        job = self.jobs.get(_ALIGN)
        return job if job is not None and job.running else None

    @property
    def picture_problem(self) -> str:
        """Why the live picture has ended by itself; empty if it has not."""
        job = self.jobs.get(_ALIGN)
        return "" if job is None or job.running or job.ending else job.problem

    @property
    def shown(self) -> Following | None:
        """What shows a picture: the session that runs, else the live picture; None without either."""
        return self.following if self.following.running or self.live_picture is not None else None

    def _rig_holder(self) -> Path | None:
        """Folder of the command that has the rig; a simulated rig has no file that names it."""
        if self.rig.path is not None:
            return self.rig.holder_folder
        return self.config.session.output if self.jobs.running(uses_camera=True) else None

    def align_whole_sensor(self) -> None:
        """Open the camera again without the region that was kept. May wait."""
        for name in _REGION:
            self.kept.pop(f"camera.{name}", None)
        self.begin_aligning()

    def keep_camera(self) -> None:
        """Use the camera's present settings for all that this desk starts; RigError if they are not valid."""
        values = self.following.applied.model_dump(exclude_none=True)
        own = {
            f"camera.{name}": values[name] for name in ("exposure_us", "gain_db", *_REGION) if name in values
        }
        self.checked(own)
        self.kept.update(own)

    def end_aligning(self) -> None:
        """End the live picture, and wait until the camera is free."""
        if (job := self.live_picture) is not None:
            job.ending = True
            try:
                # where a program cannot be interrupted it closes its devices by this alone
                self.following.order("key q")
            except RigError:
                job.end()
            if not job.wait(_CLOSES_WITHIN_S):
                darken_directly(self.config.laser, self.config.controller)
                job.kill()
        self.jobs.pop(_ALIGN, None)

    # -- the session ------------------------------------------------------------

    @property
    def start_runs(self) -> bool:
        """Whether the process of the session that this desk started last runs."""
        return self.started is not None and self.started[0].poll() is None

    @property
    def start_failed(self) -> bool:
        """Whether that process has ended with an error."""
        return self.started is not None and self.started[0].poll() not in (None, 0)

    @property
    def start_problem(self) -> str:
        """Why that process has ended with an error: what it said; empty if it has not."""
        if self.started is None or not self.start_failed:
            return ""
        return reason_in(self.last_words(), self.started[0].poll())

    @property
    def starting(self) -> bool:
        """Whether the session that this desk started last runs and has not answered yet."""
        return self.started is not None and self.start_runs and self.following.last_folder != self.started[1]

    @property
    def session_folder(self) -> Path | None:
        """Folder of the running session, else of the last one that this desk has seen or started."""
        return self.following.last_folder or (self.started[1] if self.started is not None else None)

    def last_summary(self) -> SessionSummary | None:
        """Results that the last session hands over to a person; None without a session. May take a moment."""
        folder = self.session_folder
        return None if folder is None else last_summary(folder)

    def last_words(self) -> list[str]:
        """Last lines that the last session has printed."""
        folder = self.session_folder
        try:
            text = "" if folder is None else (folder / MESSAGES_NAME).read_text("utf-8", errors="replace")
        except OSError:
            return []
        return text.splitlines()[-12:]

    def close(self) -> None:
        """End what ends with the desk; a session goes on."""
        self.alarming.stop()
        self.following.stop()
        self.safety.stop()
        self.end_aligning()
        for job in self.jobs.values():
            job.end()
        self.place.close()
