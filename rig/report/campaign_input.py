"""The input of a campaign: campaign.toml, which states its model, and the runs of folders or an archive."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log
from pathlib import Path
from typing import Annotated, Final, Self

import numpy as np
from pydantic import BaseModel, Field, model_validator

from acquisition.record.digest import sha256_of
from processing.contact import DRAG
from processing.contact.laws import DEFAULT_LAW
from processing.errors import ConfigurationError, RecordError
from processing.estimate import Estimate
from processing.series import EXPONENT_OF, FRICTION, ORDER, POSITIVE, CompressedRun, Effect, Form, SeriesModel
from rig.analysis import RunResults, read_results, results_path
from rig.settings import read_toml, validate

AMBIENT_COVARIATES: Final = ("humidity_percent", "temperature_c", "pressure_pa", "dwell_s", "age_s")
"""Covariates that are ambient conditions of a run, or times of its contact."""
COVARIATES: Final = (*AMBIENT_COVARIATES, "first_amplitude_rad", "load_n", ORDER)
"""All covariates, on which a parameter may depend."""


class StatedEffect(BaseModel, frozen=True, extra="forbid"):
    """A parameter that depends on a covariate, a condition of each run."""

    parameter: str = Field(description="b, p, c, n, period0_s, gamma_pa, drag_s, or friction: b and c alike")
    form: Form
    covariate: str = Field(default="", description=", ".join(COVARIATES))
    reference: float = Field(
        default=0.0,
        allow_inf_nan=False,
        description="value at which the effect is zero, or position of the step",
    )
    contact: str = Field(default="", description="the only contact that has it; default: all have it alike")
    margin: float | None = Field(
        default=None, gt=0, description="largest effect over the campaign's span that does not matter"
    )

    @model_validator(mode="after")
    def _has_covariate(self) -> Self:
        if self.form is not Form.DURING and not self.covariate:
            raise ValueError("covariate: is missing; state what the parameter depends on")
        if self.covariate and self.covariate not in COVARIATES:
            known = ", ".join(COVARIATES)
            raise ValueError(f"there is no covariate {self.covariate!r}; a campaign has {known}")
        if self.form is Form.DURING and self.parameter != FRICTION:
            raise ValueError("form = 'during': is of parameter = 'friction'")
        return self

    def effect(self) -> Effect:
        """The effect as a term of the model."""
        return Effect(**self.model_dump(exclude={"margin"}))


class StatedLevel(BaseModel, frozen=True, extra="forbid"):
    """Prior knowledge of a parameter: a normal distribution."""

    value: float
    u: float = Field(gt=0)


class StatedCampaign(BaseModel, frozen=True, extra="forbid"):
    """The contents of campaign.toml."""

    parameters: tuple[str, ...] = Field(
        default=(), description="parameters that are modelled; default: all that runs determine"
    )
    reference_arcsec: float = Field(
        default=60.0, gt=0, description="amplitude at which b and gamma scatter, and change with covariates"
    )
    contacts_alike: bool = Field(
        default=False, description="contacts are of one kind and scatter about a mean"
    )
    bad_run_chance: float = Field(default=0.02, ge=0, lt=0.5)
    draws: int = Field(default=1000, ge=100, le=100_000)
    seed: int = Field(default=1, ge=0)
    effect: tuple[StatedEffect, ...] = ()
    change_points: tuple[str, ...] = Field(
        default=(), description="parameters that may have become other ones at some run"
    )
    prior: dict[str, StatedLevel] = Field(default_factory=dict, description="prior knowledge, by parameter")
    size: dict[str, Annotated[float, Field(gt=0, allow_inf_nan=False)]] = Field(
        default_factory=dict,
        description="by parameter, how far an effect may move it and how far runs may scatter: for b, "
        "c and gamma_pa a fraction of the value",
    )

    @model_validator(mode="after")
    def _has_no_duplicates(self) -> Self:
        for key, entries in (("parameters", self.parameters), ("effect", self.effect)):
            if len(set(entries)) < len(entries):
                raise ValueError(f"{key}: the same is stated twice")
        return self


def read_campaign(path: Path) -> StatedCampaign:
    """Read campaign.toml; raises ConfigurationError with one line for all of its faults."""
    campaign, faults = validate(StatedCampaign, read_toml(path, "campaign"))
    if campaign is None:
        raise ConfigurationError(f"{path}: {'; '.join(fault.line for fault in faults)}")
    return campaign


def stated_model(stated: StatedCampaign, reference_rad: float, runs: Sequence[CompressedRun]) -> SeriesModel:
    """The model of a stated campaign; raises ConfigurationError for unknown parameters and contacts."""
    known, contacts = (*DEFAULT_LAW.names(), DRAG.key), list(dict.fromkeys(run.contact for run in runs))
    if unknown := [name for name in stated.parameters if name not in known]:
        raise ConfigurationError(f"parameters: there is no {unknown[0]!r}; a campaign has {', '.join(known)}")
    if unknown := [name for name in stated.size if name not in (*known, FRICTION)]:
        raise ConfigurationError(
            f"size.{unknown[0]}: there is no such parameter; a campaign has {', '.join(known)}"
        )
    for effect in stated.effect:
        if effect.contact and effect.contact not in contacts:
            raise ConfigurationError(
                f"contact = {effect.contact!r}: no such contact; the runs are of {', '.join(contacts)}"
            )
    of_runs = {name for run in runs for name in (*run.names, *run.bounds)}
    names = stated.parameters or tuple(name for name in known if name in of_runs)
    levels = {}
    for name, prior in stated.prior.items():
        if name not in names:
            raise ConfigurationError(f"prior.{name}: is not one of the parameters {', '.join(names)}")
        value, u = prior.value, prior.u
        if name in POSITIVE:
            if not value > 0:
                raise ConfigurationError(f"prior.{name}.value = {value:g}: should be above 0")
            value, u = log(value), u / value
        if name in EXPONENT_OF:
            # the coordinate is taken at the median of the runs' exponents
            exponent, offset = EXPONENT_OF[name]
            exponents = [run.values[run.names.index(exponent)] for run in runs if exponent in run.names]
            value += (float(np.median(exponents)) - offset) * log(reference_rad)
        levels[name] = Estimate(value, u)
    return SeriesModel(
        names=names,
        effects=tuple(effect.effect() for effect in stated.effect),
        sizes=stated.size,
        levels=levels,
        contacts_alike=stated.contacts_alike,
        bad_run_chance=stated.bad_run_chance,
    )


@dataclass(frozen=True, kw_only=True)
class CandidateRun:
    """A run that may enter a campaign."""

    label: str
    contact: str
    sha256: str = ""
    """SHA-256 of the record."""
    results_sha256: str
    """SHA-256 of the results file."""
    run: RunResults


def runs_of_folders(folders: Sequence[Path]) -> list[CandidateRun]:
    """All runs of sessions, in the order of the folders; each folder is a contact.

    A folder without results of its own stands for all series in its subfolders, as one contact.

    Raises ConfigurationError for a run or folder that occurs twice, and RecordError.
    """
    names = [folder.resolve().name if folder.is_dir() else folder.resolve().parent.name for folder in folders]
    runs: list[CandidateRun] = []
    for folder, name in zip(folders, names, strict=True):
        label, sessions = name if names.count(name) == 1 else str(folder), [folder]
        if folder.is_dir() and not any(folder.glob("results*.json")):
            sessions = sorted({path.parent for path in folder.glob("*/results*.json")}) or sessions
        for session in sessions:
            session_label = label if session == folder else f"{label}/{session.name}"
            runs += _runs(results_path(session), session_label, label)
    return _without_duplicates(runs)


def runs_of_archive(rows: Sequence[Sequence[str]]) -> list[CandidateRun]:
    """Runs that an archive lists in order (`rig.archive.ordered_runs`); each sample is a contact."""
    runs: list[CandidateRun] = []
    for sha256, name, sample, folder, results in rows:
        path = Path(folder) / results
        matches = [run for run in _runs(path, "", sample or path.parent.name) if run.sha256 == sha256]
        if not matches:
            raise RecordError(f"{path}: knows no run {sha256[:8]}; rig archive update reads it again")
        runs.append(replace(matches[0], label=f"{path.parent.name}/{name}"))
    return _without_duplicates(runs)


def _runs(path: Path, folder: str, contact: str) -> list[CandidateRun]:
    results, sha256 = read_results(path), sha256_of(path)
    return [
        CandidateRun(
            label="/".join(filter(None, (folder, identity.name or f"run-{number}"))),
            contact=contact, sha256=identity.sha256, results_sha256=sha256, run=run,
        )
        for number, (run, identity) in enumerate(zip(results.runs, results.identities, strict=True), start=1)
    ]  # fmt: skip


def _without_duplicates(runs: list[CandidateRun]) -> list[CandidateRun]:
    """The runs unchanged; raises ConfigurationError if a run occurs twice."""
    runs_by_hash: dict[str, list[CandidateRun]] = {}
    for run in runs:
        earlier = runs_by_hash.setdefault(run.run.sha256, [])
        label = next((other.label for other in earlier if run.run.is_of_same_motion(other.run)), None)
        if label == run.label:
            raise ConfigurationError(f"{label}: its folder is named twice, and counts once; name it once")
        if label is not None:
            raise ConfigurationError(f"{run.label}: is the run of {label} (same hash), which counts once")
        earlier.append(run)
    return runs
