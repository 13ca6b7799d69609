"""The file `decisions.json`: which runs a night that decides has chosen, why, and what became of them."""

import datetime
import json
from enum import StrEnum
from pathlib import Path
from typing import Any

from pydantic import AwareDatetime, BaseModel, ValidationError

from acquisition.record import whole_file
from processing.errors import ConfigurationError, RecordError

DECISIONS_NAME = "decisions.json"
_SCHEMA = 1


class ChosenState(StrEnum):
    """What became of a chosen run."""

    CHOSEN = "chosen"
    """It is waited for or measured; after a kill it is made when the night goes on."""
    MEASURED = "measured"
    FAILED = "failed"
    """It has no results, or its conditions were never met."""


class Ending(StrEnum):
    """Why a night chooses no further run."""

    REACHED = "reached"
    CANNOT = "cannot be reached"
    LIMIT = "a limit of the plan"
    CONDITIONS = "conditions were not met"


class Decision(BaseModel, frozen=True, extra="forbid"):
    """A chosen run. `u_before` is the worst uncertainty over its limit when it was chosen, `u_expected` what
    was expected after it; `rig_time_s` what it was expected to take, with `waiting_s` before it."""

    number: int
    folder: str
    first_arcsec: float
    last_arcsec: float
    sample: str
    waiting_s: float
    rig_time_s: float
    chosen_utc: AwareDatetime
    after_runs: int
    u_before: float
    u_expected: float
    why: str
    state: ChosenState = ChosenState.CHOSEN
    said: str = ""


class Decisions(BaseModel, frozen=True, extra="forbid"):
    """The whole file. `plan` is what was asked for when the night was last begun; `waiting` what it waits for
    now; `u_now` the worst uncertainty over its limit after the last run."""

    schema_version: int = _SCHEMA
    plan: dict[str, Any]
    begun_utc: AwareDatetime
    decisions: tuple[Decision, ...] = ()
    waiting: str = ""
    u_now: float | None = None
    ending: Ending | None = None
    said: str = ""

    @property
    def measured(self) -> list[Decision]:
        """Those that were made, in their order."""
        return [one for one in self.decisions if one.state is ChosenState.MEASURED]

    @property
    def pending(self) -> Decision | None:
        """The one that was chosen and not finished."""
        return next((one for one in self.decisions if one.state is ChosenState.CHOSEN), None)

    @property
    def rig_time_s(self) -> float:
        """What the runs so far were expected to take."""
        return sum(one.rig_time_s for one in self.decisions if one.state is not ChosenState.CHOSEN)


class DecisionsFile:
    """The file of one night's folder, replaced as a whole at each change."""

    def __init__(self, folder: Path, now_utc: datetime.datetime, plan: dict[str, Any]) -> None:
        self._path = folder / DECISIONS_NAME
        self.goes_on = self._path.exists()
        if self.goes_on:
            self.now = _read(self._path)
            self.changed = [
                f"{key} = {json.dumps(plan.get(key))} (was {json.dumps(self.now.plan.get(key))})"
                for key in sorted(plan.keys() | self.now.plan.keys())
                if plan.get(key) != self.now.plan.get(key)
            ]
            self.save(plan=plan, waiting="", ending=None, said="")
        else:
            self.changed = []
            self.now = Decisions(plan=plan, begun_utc=now_utc)
            self.save()

    def save(self, **changes: object) -> None:
        """Change the file. Raises RecordError where it cannot be written."""
        self.now = self.now.model_copy(update=changes)
        try:
            whole_file.replace(self._path, json.dumps(self.now.model_dump(mode="json"), indent=1).encode())
        except OSError as error:
            raise RecordError(f"{self._path}: cannot be written: {error.strerror or error}") from None

    def note(self, decision: Decision) -> None:
        """Add a decision, or put it in place of the one of the same number."""
        others = tuple(one for one in self.now.decisions if one.number != decision.number)
        self.save(decisions=(*others, decision), waiting="")


def _read(path: Path) -> Decisions:
    try:
        found = Decisions.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise ConfigurationError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None
    if found.schema_version > _SCHEMA:
        raise ConfigurationError(
            f"{path}: schema {found.schema_version} was written by a later version; this one reads up to "
            f"{_SCHEMA}"
        )
    return found
