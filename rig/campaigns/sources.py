"""The runs of a campaign: of folders, or of an archive's rows that meet a condition."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from acquisition.record.digest import sha256_of
from processing.errors import ConfigurationError, RecordError
from rig.analysis import read_results, results_path
from rig.campaigns.likelihoods import FoundRun

_SESSION = "session.json"
_IN_ORDER = """
with numbered as (
  select *, coalesce(try_cast(regexp_extract(run, '[0-9]+$') as bigint), 0) as number from chosen
)
select sha256, run, sample, folder, results from numbered where results is not null
order by max(began_utc) over (partition by folder order by number, run) nulls last, folder, number, run
"""
"""Runs of one session follow each other by their numbers, also where the clock was set back between them."""


@dataclass(frozen=True)
class NamedRuns:
    """Runs as a command names them: folders, or those of an archive that meet a condition.

    Raises ConfigurationError for what excludes each other, or has no effect.
    """

    folders: Sequence[Path] = ()
    archive: Path | None = None
    where: str = ""
    by_sample: bool = False

    def __post_init__(self) -> None:
        if self.archive is not None and self.folders:
            raise ConfigurationError(
                f"{self.folders[0]}: folders and --archive exclude each other; leave one out"
            )
        if self.where and self.archive is None:
            raise ConfigurationError(f"--where {self.where!r}: has no effect without --archive")
        if self.by_sample and self.archive is not None:
            raise ConfigurationError(
                "--by-sample: has no effect with --archive, where each sample is a contact"
            )

    def found(self) -> list[FoundRun]:
        """The runs; none where nothing is named."""
        if self.archive is None:
            return runs_of_folders(self.folders, by_sample=self.by_sample)
        return _runs_of_archive(self.archive, self.where)


def runs_of_folders(folders: Sequence[Path], *, by_sample: bool = False) -> list[FoundRun]:
    """All runs of sessions, in the order in which they are named; each folder is a contact, with `by_sample`
    each sample is one. Of a folder of several series, which has no results of its own, all series that have
    some are taken, as one contact.

    Raises ConfigurationError where a run or a folder is there twice, or a folder does not tell its sample,
    RecordError where one cannot be read.
    """
    names = [folder.resolve().name if folder.is_dir() else folder.resolve().parent.name for folder in folders]
    found: list[FoundRun] = []
    for folder, name in zip(folders, names, strict=True):
        label, sessions = name if names.count(name) == 1 else str(folder), [folder]
        if folder.is_dir() and not any(folder.glob("results*.json")):
            sessions = sorted({path.parent for path in folder.glob("*/results*.json")}) or sessions
        for session in sessions:
            own = label if session == folder else f"{label}/{session.name}"
            contact = _sample(session) if by_sample else label
            found += _runs(results_path(session), own, contact)
    return _different(found)


def _sample(folder: Path) -> str:
    """The sample that the configuration of a session, or of a table's fit, states."""
    runs = read_results(results_path(folder)).runs
    of_table = [run.decay.session for run in runs if run.decay is not None]
    place = folder if folder.is_dir() else folder.parent
    path = results_path(folder) if of_table else place / _SESSION
    try:
        session = of_table[0] if of_table else json.loads(path.read_bytes())["configuration"]["session"]
        sample = session.get("sample", "")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigurationError(
            f"{path}: names no sample ({type(error).__name__}); leave out --by-sample, then each folder is a "
            "contact"
        ) from None
    if not sample:
        raise ConfigurationError(f"{path}: its session.sample is empty; leave out --by-sample")
    return str(sample)


def _runs_of_archive(archive: Path, where: str) -> list[FoundRun]:
    """The runs of an archive that meet a condition, by their beginnings; a sample is a contact."""
    from rig.archive import selected

    found: list[FoundRun] = []
    for sha256, run, sample, folder, results in selected(archive, "*", where, _IN_ORDER)[1]:
        path = Path(folder) / results
        own = [one for one in _runs(path, "", sample or path.parent.name) if one.run.sha256 == sha256]
        if not own:
            raise RecordError(f"{path}: knows no run {sha256[:8]}; rig archive update reads it again")
        found.append(replace(own[0], label=f"{path.parent.name}/{run}"))
    if not found:
        raise ConfigurationError(
            f"condition {where!r}: no run with results meets it; rig archive list shows all"
        )
    return _different(found)


def _runs(path: Path, folder: str, contact: str) -> list[FoundRun]:
    results, sha256 = read_results(path), sha256_of(path)
    return [
        FoundRun(
            label="/".join(filter(None, (folder, Path(run.record).stem or f"run-{number}"))),
            contact=contact, results_sha256=sha256, run=run,
        )
        for number, run in enumerate(results.runs, start=1)
    ]  # fmt: skip


def _different(runs: list[FoundRun]) -> list[FoundRun]:
    """The runs, of which none may be there twice: it counts once."""
    seen: dict[str, str] = {}
    for one in runs:
        before = seen.get(one.run.sha256)
        if before == one.label:
            raise ConfigurationError(f"{one.label}: its folder is named twice, and counts once; name it once")
        if before is not None:
            raise ConfigurationError(f"{one.label}: is the run of {before} (same hash), which counts once")
        if one.run.sha256:
            seen[one.run.sha256] = one.label
    return runs
