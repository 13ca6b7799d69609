"""The balance at the desk: the command that measures it, what it is answered, what was learned so far."""

from typing import TYPE_CHECKING

from processing.errors import ConfigurationError
from rig.balance import BalanceDialogue, BalanceStage, Learned, balance_dialogue, history_path, learned
from rig.desk.jobs import Job
from rig.instrument import complete

if TYPE_CHECKING:
    from rig.desk.desk import Desk

_NAME = "balance"
_MEASURE, _FORGET, _END = "", "f", "q"
"""Answers that the command takes between two measurements, besides a turn."""


class Balancing:
    """Of one desk. What may wait for the camera says so."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk

    @property
    def running(self) -> bool:
        """Whether it is measured, or a turn is waited for."""
        return self._job is not None

    @property
    def shown(self) -> BalanceDialogue:
        """Where it stands; before anything was measured, what a session that runs says of it."""
        job = self._desk.jobs.get(_NAME)
        if job is not None:
            return balance_dialogue(
                list(job.lines), list(job.said), running=job.running, failed=bool(job.status)
            )
        news = self._desk.following.news
        path = news.get("path") or {"x": [], "y": []}
        next_step = (news.get("balance") or {}).get("next_step")
        words = next_step or "Measure: let it swing, not too far"
        return BalanceDialogue(BalanceStage.IDLE, words, x=path["x"], y=path["y"])

    @property
    def unit(self) -> str:
        """Of the trajectory."""
        is_own = _NAME in self._desk.jobs
        return "arcsec" if is_own else str(self._desk.following.news.get("unit") or "arcsec")

    def measure(self) -> None:
        """Measure, or measure again. May wait."""
        job = self._job
        if job is None:
            words = ["--seed", "1"] if self._desk.config.simulated else []
            self._desk.start(_NAME, "--json", *words)
        elif _asks(job):
            job.answer(_MEASURE)

    def turned(self, weight: str, turns: str) -> None:
        """A weight was turned so far; what it does is measured next."""
        job = self._job
        if job is None or not _asks(job):
            raise ConfigurationError("first measure: a turn is stated between two measurements")
        job.answer(f"{weight} {turns.strip()}")

    def forget(self) -> None:
        """Take the last turn back. May wait."""
        job = self._job
        if job is None:
            self._desk.start(_NAME, "--forget-last")
        elif not _asks(job):
            raise ConfigurationError("wait for the end of the measurement")
        else:
            job.answer(_FORGET)

    def end(self) -> None:
        """End it; a measurement that goes on is given up."""
        job = self._job
        if job is None:
            return
        if _asks(job):
            job.answer(_END)
            job.ending = True
        else:
            job.end()

    def learned(self) -> Learned:
        """What the turns so far have taught. Raises RigError for a history that cannot be read. May wait."""
        config = complete(self._desk.checked())
        return learned(config, history_path(config, None))

    @property
    def _job(self) -> Job | None:
        found = self._desk.jobs.get(_NAME)
        return found if found is not None and found.running else None


def _asks(job: Job) -> bool:
    """Whether the command waits for an answer."""
    return bool(job.lines) and job.lines[-1]["kind"] == "ask"
