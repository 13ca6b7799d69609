"""The archive that the desk shows, of this machine or on a server; it is only read."""

import threading
import time
from pathlib import Path

from rig.archive import FoundRuns, brought, find_runs, is_remote

_FETCHED_S = 30.0
"""So long what was fetched from a server is taken for what is there."""


class Archived:
    """The archive of this name (a folder, or an address of a server); empty for none."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._remote = is_remote(name)
        self._one_at_a_time = threading.Lock()
        self._fetched: tuple[Path, float] | None = None

    @property
    def is_there(self) -> bool:
        """Whether there is something to look into; of one on a server only a look will tell."""
        return self._remote or (bool(self.name) and Path(self.name).is_dir())

    def find(self, words: str, first: int, most: int) -> FoundRuns:
        """Runs with all these words. Raises RigError where the archive cannot be read. May wait."""
        return find_runs(self._folder(), words, first, most)

    def _folder(self) -> Path:
        if not self._remote:
            return Path(self.name)
        with self._one_at_a_time:
            now_s = time.monotonic()
            if self._fetched is None or now_s - self._fetched[1] > _FETCHED_S:
                self._fetched = brought(self.name), now_s
            return self._fetched[0]
