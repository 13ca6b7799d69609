"""The plan of a night that decides: what is to be reached, between which limits; its runs are chosen one by
one."""

import datetime
from pathlib import Path
from typing import Annotated, Self

from pydantic import AwareDatetime, BaseModel, Field, model_validator

from processing.errors import ConfigurationError
from rig.settings.night_plan import RunConditions
from rig.settings.toml_file import read_toml
from rig.settings.wording import validated

_Arcsec = Annotated[float, Field(gt=0)]
_TABLE = "auto"


class DecidingPlan(RunConditions, frozen=True, extra="forbid"):
    """Table [auto] of a plan's file; paths are relative to the file's folder."""

    config: Path
    targets: tuple[str, ...] = Field(min_length=1, alias="for", description="as with rig plan --for")
    set: tuple[str, ...] = Field(default=(), description="KEY=VALUE, as with --set")
    campaign: Path | None = Field(default=None, description="what is stated (campaign.toml)")
    after: tuple[Path, ...] = Field(default=(), description="folders of runs of the sample that were made")
    archive: str | None = Field(default=None, description="the same, of an archive")
    where: str = Field(default="", description="its runs that meet a condition")
    contact: Path | None = Field(default=None, description="results.json with the contact that is expected")
    noise_arcsec: float | None = Field(default=None, gt=0, description="of one frame, where it is known")
    first_arcsec: tuple[_Arcsec, ...] = Field(min_length=1, description="amplitudes that a run may begin at")
    last_arcsec: tuple[_Arcsec, ...] = Field(min_length=1, description="amplitudes that a run may end at")
    waits_min: tuple[Annotated[float, Field(ge=0)], ...] = Field(
        default=(0.0,), min_length=1, description="before a run, among which is chosen"
    )
    max_runs: int = Field(ge=1, le=1000)
    hours: float | None = Field(default=None, gt=0, description="from the first beginning on")
    until: datetime.time | AwareDatetime | None = Field(
        default=None, description="07:00:00, the next one after the beginning, or a date with its offset"
    )
    attended: bool = Field(
        default=False, description="a person is there for every run, and releases the pendulum by hand"
    )

    @model_validator(mode="after")
    def _ends(self) -> Self:
        if self.hours is None and self.until is None:
            raise ValueError("hours: is missing; state hours or until, at which the night ends")
        return self

    def ends_utc(self, begun_utc: datetime.datetime) -> datetime.datetime:
        """When the night ends that began then: the earlier one of both ends."""
        ends = [] if self.hours is None else [begun_utc + datetime.timedelta(hours=self.hours)]
        if isinstance(self.until, datetime.datetime):
            ends.append(self.until)
        elif self.until is not None:
            begun = begun_utc.astimezone()
            # a naive sum has the local time also where the clocks are changed this night
            day = begun.date() + datetime.timedelta(days=begun.time() >= self.until)
            ends.append(datetime.datetime.combine(day, self.until).astimezone())
        return min(ends).astimezone(datetime.UTC)


class _File(BaseModel, frozen=True, extra="forbid"):
    auto: DecidingPlan


def decides(path: Path) -> bool:
    """Whether a plan's file is one that decides, and lists no series."""
    return _TABLE in read_toml(path, "plan")


def load_deciding_plan(path: Path) -> DecidingPlan:
    """Read a plan; one line of error names every fault."""
    file, faults = validated(_File, read_toml(path, "plan"))
    if file is None:
        raise ConfigurationError(f"{path}: {'; '.join(fault.line for fault in faults)}")
    plan, folder = file.auto, path.parent
    return plan.model_copy(
        update={
            "config": folder / plan.config,
            "campaign": None if plan.campaign is None else folder / plan.campaign,
            "contact": None if plan.contact is None else folder / plan.contact,
            "archive": plan.archive
            if plan.archive is None or "://" in plan.archive
            else str(folder / plan.archive),
            "after": tuple(folder / one for one in plan.after),
        }
    )
