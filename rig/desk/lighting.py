"""Light at the desk: everything dark at once, a trip that is acknowledged, and light again by a person."""

import threading
from collections import deque
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from processing.errors import ConfigurationError, RigError
from rig.channel import CHANNEL_NAME, Line
from rig.control import darken_beside
from rig.devices import Devices

if TYPE_CHECKING:
    from rig.desk.desk import Desk

_PRESSES_KEPT = 64


class Lighting:
    """Of whatever lights at a desk: its live picture, the session it follows, the commands it has started."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk
        self._pressing = threading.Lock()
        self._pressed: deque[str] = deque(maxlen=_PRESSES_KEPT)

    def off(self, press: str = "") -> list[str]:
        """Everything dark, whoever has lit it; returns what failed. Waits for no device, session or command.

        Ports are told off directly, too: a frozen session hears its order only when it goes on, and then
        stays dark. The same `press` comes by two ways: the later one must not darken what a person has
        acknowledged and lit again meanwhile.
        """
        with self._pressing:
            if press and press in self._pressed:
                return []
            self._pressed.append(press)
        desk = self._desk
        if (aligner := desk.aligner) is not None:
            aligner.light_off()
        problems = darken_beside(desk.config.laser, desk.config.controller)
        folders = {folder.absolute() for folder in (desk.following.folder,) if folder is not None}
        if (begun := desk.started) is not None and begun[0].poll() is None:
            folders.add(begun[1].absolute())
            if desk.following.last_folder != begun[1] and not (begun[1] / CHANNEL_NAME).exists():
                # it hears no order yet; one that was seen before, and is gone, is being fitted
                begun[0].terminate()
        for folder in folders:
            threading.Thread(target=_order_dark, args=(folder,), name="light off", daemon=True).start()
        # in a thread of its own: a disk that hangs holds nothing else up
        threading.Thread(target=self._holder_dark, args=(folders,), name="light off", daemon=True).start()
        for job in tuple(desk.jobs.values()):
            if job.running:
                job.end()
        return problems

    def _holder_dark(self, told: Collection[Path]) -> None:
        """Also the program that has the rig and works in another folder."""
        folder = self._desk.rig.folder_of_holder
        if folder is not None and folder not in told:
            _order_dark(folder)

    def acknowledge(self, number: int) -> str:
        """Somebody has looked that nobody is in the beam's way; raises RigError if that cannot be. May wait.

        Lights nothing.
        """
        desk = self._desk
        if (aligner := desk.aligner) is not None and aligner.running:
            return aligner.acknowledge(number)
        if desk.following.running:
            return desk.following.order(f"acknowledge {number}")
        for name, job in desk.jobs.items():
            if job.running:
                raise ConfigurationError(f"rig {name} has the devices; end it, then acknowledge")
        with Devices(desk.config, desk.config.session.output, "the desk", desk.safety.unfiled) as devices:
            devices.wait_until_heard()
            return devices.acknowledge(number, "the desk")

    def again(self) -> str:
        """Light again what waits in the dark; raises RigError if nothing does. May wait."""
        desk = self._desk
        if (aligner := desk.aligner) is not None and aligner.running:
            aligner.relight()
            return "light is asked for"
        return desk.following.order("light")

    @property
    def may_follow(self) -> bool:
        """Whether something is there that light could be given to, once the trip is acknowledged."""
        desk = self._desk
        aligner = desk.aligner
        return desk.following.running or (aligner is not None and aligner.running)

    @property
    def waits(self) -> bool:
        """Whether something that was lit is dark, and may be lit again."""
        desk = self._desk
        now = desk.safety.now
        if now.trip is not None:
            return False
        if (aligner := desk.aligner) is not None:
            return aligner.running and bool(aligner.darkness)
        news = desk.following.news
        if desk.following.running and now.to_be_asked:
            # between two runs, too
            return True
        return bool(news.get("darkness") and (news.get("state") or {}).get("alarm"))


def _order_dark(folder: Path) -> None:
    with suppress(RigError), Line(folder) as line:
        line.order("dark")
