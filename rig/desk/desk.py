"""State that all tabs of the desk share: configuration, running session, started commands."""

import os
import signal
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from calibration import toml_value
from processing.errors import ConfigurationError, RigError
from rig.control import SafetyState, darken_directly, rig_state_path
from rig.desk.alarming import Alarming
from rig.desk.follower import RigFollower
from rig.desk.jobs import MESSAGES_NAME, Balancing, Job, Jobs, StartedSession, failure_reason, start_session
from rig.desk.lighting import Lighting, Safety
from rig.desk.sessions import SessionIndex, last_summary
from rig.desk.store import DeskStore
from rig.devices import NoSession
from rig.instrument import complete
from rig.measure import SessionSummary, session_folder
from rig.settings import Configuration, load_configuration

_MAX_CAMERA_WAIT_S = 5.0
_MAX_WAKE_S = 10.0
"""Time within which a process that was stopped (Ctrl-Z) and continued answers again, or has ended."""
_LOOK_INTERVAL_S = 0.1
_MAX_CLOSING_S = 10.0
_MAX_LAST_LINES = 12
_ALIGN = "camera align"
_REGION = ("width_px", "height_px", "offset_x_px", "offset_y_px")


class Desk:
    """The desk of one configuration file; `overrides` are as of --set, and hold for all that it starts."""

    def __init__(self, source: Path, overrides: tuple[str, ...] = (), archive: Path = Path()) -> None:
        self.source = source
        self.archive = archive
        """The archive whose runs are listed as well."""
        self._overrides = overrides
        self.own_settings: dict[str, object] = {}
        """Settings made at the desk (exposure, region, calibrations) by key, valid until the desk ends."""
        self.config = load_configuration(source, overrides)
        self.balancing = Balancing(self)
        self.follower = RigFollower(self.config.session.output, self._command_folder)
        self.rig_state = SafetyState(rig_state_path(self.config.laser, self.config.controller))
        self.jobs = Jobs()
        light_device = "board" if self.config.laser.kind == "controller" else "laser"
        self.safety = Safety(self.rig_state, self.follower, light_device)
        self.sessions = SessionIndex(self.config.session.output)
        self.last_start: StartedSession | None = None
        """The session that this desk started last; None before any."""
        self.store = DeskStore()
        self.alarming = Alarming(self)
        self.lighting = Lighting(self)
        self._lock = threading.Lock()

    # -- the configuration ------------------------------------------------------

    def overridden(self, values: Mapping[str, object] | None = None) -> list[str]:
        """KEY=VALUE of everything that differs from the file, `values` last."""
        own = {**self.own_settings, **(values or {})}
        stated = [override for override in self._overrides if override.partition("=")[0].strip() not in own]
        return [*stated, *(f"{key}={toml_value(value)}" for key, value in own.items())]

    def _set_options(self, values: Mapping[str, object] | None = None) -> list[str]:
        return [word for override in self.overridden(values) for word in ("--set", override)]

    def checked(self, values: Mapping[str, object] | None = None) -> Configuration:
        """The configuration with `values` changed; raises ConfigurationError with the models' own words."""
        return load_configuration(self.source, self.overridden(values))

    # -- commands and sessions --------------------------------------------------

    def start(self, name: str, *words: str) -> Job:
        """Start a command of this configuration that uses the camera, and ends with the desk.

        It shows its light in the folder of the sessions. Raises ConfigurationError if the camera is in use,
        or a trip is not acknowledged. May wait.
        """
        self._free_rig(name)
        with suppress(OSError):
            # without this folder a rig whose laser is not switched shows no picture
            self.config.session.output.mkdir(parents=True, exist_ok=True)
        return self.jobs.begin(name, str(self.source), *words, *self._set_options(), uses_camera=True)

    def start_session(self, values: Mapping[str, object], *, force: bool = False) -> Path:
        """Start `rig run` with these values; it goes on when the desk ends. Returns the session's folder."""
        with self._lock:
            self._free_rig("run")
            config = self.checked(values)
            folder, _ = session_folder(config, self.source, None)
            words = ["run", str(self.source), "-o", str(folder), *self._set_options(values)]
            self.last_start = start_session([*words, "--force"] if force else words, folder)
        self.follower.search_now(folder)
        return folder

    def resume_session(self, folder: Path) -> None:
        """Start `rig run --resume`; it goes on when the desk ends."""
        with self._lock:
            self._free_rig("run")
            self.last_start = start_session(["run", "--resume", str(folder)], folder)
        self.follower.search_now(folder)

    def stop_session(self, max_wake_s: float = _MAX_WAKE_S) -> str:
        """Stop the session, which may be frozen; returns what was done. May wait.

        The light of a frozen session is switched off at the ports, then its process is told to end, and to go
        on if it was stopped (Ctrl-Z): it closes its record, if it can. A process that still does not react is
        killed. Raises RigError if the session cannot be stopped.
        """
        follower = self.follower
        if not follower.frozen:
            return follower.order("stop")
        process = follower.process
        if process is None:
            raise NoSession("the session does not answer, and its process is not known; end it by hand")
        problems = darken_directly(self.config.laser, self.config.controller)
        lit = f"; the laser may be lit: {'; '.join(problems)}" if problems else ""
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGTERM)
            if hasattr(signal, "SIGCONT"):
                # Ctrl-Z stops its helpers, too
                os.killpg(os.getpgid(process), signal.SIGCONT)
            deadline_s = time.monotonic() + max_wake_s
            while follower.frozen and time.monotonic() < deadline_s:
                time.sleep(_LOOK_INTERVAL_S)
            if not follower.frozen:
                return f"the session was frozen; its process ends, and closes its record if it can{lit}"
            os.kill(process, getattr(signal, "SIGKILL", signal.SIGTERM))
        return f"the session was frozen; its process was killed, Resume measures the missing runs{lit}"

    def free_camera(self, command: str) -> None:
        """Free the camera for `rig COMMAND`; raises ConfigurationError if another program has it. May wait.

        A session that was stopped, and a command that has reported its result, still close their devices.
        """
        self.end_aligning()
        deadline_s = time.monotonic() + _MAX_CAMERA_WAIT_S
        while holder := self._camera_holder():
            if time.monotonic() > deadline_s:
                raise ConfigurationError(
                    f"rig {command} needs the camera, which {holder} has; wait, or end it first"
                )
            time.sleep(_LOOK_INTERVAL_S)

    def _camera_holder(self) -> str:
        """The session or command, other than the live picture, that has the camera; empty without one."""
        if self.follower.running or self.start_runs:
            return "a session"
        return next((f"rig {name}" for name, _ in self.jobs.running(uses_camera=True)), "")

    def _free_rig(self, command: str) -> None:
        """Free the camera; raises ConfigurationError while a trip is latched. May wait."""
        if (trip := self.safety.trip) is not None:
            raise ConfigurationError(f"rig {command} is not started: {trip.text}; acknowledge it first")
        self.free_camera(command)

    def begin_aligning(self) -> None:
        """Start the live picture. May wait."""
        config = complete(self.checked())
        self.start(_ALIGN)
        self.follower.search_now(config=config)

    @property
    def live_picture(self) -> Job | None:
        """The command of the live picture that runs; None without one."""
        return self.jobs.running_job(_ALIGN)

    @property
    def picture_problem(self) -> str:
        """Why the live picture has ended by itself; empty if it has not."""
        job = self.jobs.get(_ALIGN)
        return "" if job is None or job.running or job.end_requested else job.problem

    @property
    def picture_source(self) -> RigFollower | None:
        """The follower while a session or a live picture runs; else None."""
        return self.follower if self.follower.running or self.live_picture is not None else None

    def _command_folder(self) -> Path | None:
        """Folder of the command that has the rig; a simulated rig has no file that names it."""
        if self.rig_state.path is not None:
            return self.rig_state.holder_folder
        return self.config.session.output if self.jobs.running(uses_camera=True) else None

    def align_whole_sensor(self) -> None:
        """Open the camera again without the region set at the desk. May wait."""
        for name in _REGION:
            self.own_settings.pop(f"camera.{name}", None)
        self.begin_aligning()

    def keep_camera_settings(self) -> None:
        """Use the settings of the newest frame, if there is one, for all that this desk starts.

        Raises RigError if they are not valid.
        """
        frame = self.follower.frame
        values = {} if frame is None else frame.applied.model_dump(exclude_none=True)
        own = {
            f"camera.{name}": values[name] for name in ("exposure_us", "gain_db", *_REGION) if name in values
        }
        self.checked(own)
        self.own_settings.update(own)

    def end_aligning(self) -> None:
        """End the live picture, and wait until the camera is free."""
        if (job := self.live_picture) is not None:
            job.end_requested = True
            try:
                # on systems without interrupts only this order lets the program close its devices
                self.follower.order("key q")
            except RigError:
                job.end()
            if not job.wait(_MAX_CLOSING_S):
                darken_directly(self.config.laser, self.config.controller)
                job.kill()
        self.jobs.pop(_ALIGN, None)

    # -- the session ------------------------------------------------------------

    @property
    def start_runs(self) -> bool:
        """Whether the process of the session that this desk started last runs."""
        return self.last_start is not None and self.last_start.status is None

    @property
    def start_failed(self) -> bool:
        """Whether the process of that session has ended with an error."""
        return self.last_start is not None and self.last_start.status not in (None, 0)

    @property
    def start_problem(self) -> str:
        """Why the process of that session has ended with an error; empty if it has not."""
        if self.last_start is None or not self.start_failed:
            return ""
        return failure_reason(self.last_lines(), self.last_start.status)

    @property
    def starting(self) -> bool:
        """Whether the session that this desk started last runs and has not answered yet."""
        start = self.last_start
        return start is not None and start.status is None and self.follower.last_folder != start.folder

    @property
    def session_folder(self) -> Path | None:
        """Folder of the running session, else of the last session that this desk has followed or started."""
        return self.follower.last_folder or (None if self.last_start is None else self.last_start.folder)

    def last_summary(self) -> SessionSummary | None:
        """Summary of the last session; None without a session. May take a moment."""
        folder = self.session_folder
        return None if folder is None else last_summary(folder)

    def last_lines(self) -> list[str]:
        """Last lines that the last session has printed."""
        folder = self.session_folder
        try:
            text = "" if folder is None else (folder / MESSAGES_NAME).read_text("utf-8", errors="replace")
        except OSError:
            return []
        return text.splitlines()[-_MAX_LAST_LINES:]

    def close(self) -> None:
        """End what ends with the desk; a session goes on."""
        self.alarming.stop()
        self.follower.stop()
        self.safety.stop()
        self.end_aligning()
        for job in self.jobs.values():
            job.end()
        self.store.close()
