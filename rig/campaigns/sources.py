"""The runs of a campaign, from folders or from an archive."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from acquisition.record.digest import sha256_of
from processing.errors import ConfigurationError, RecordError
from rig.analysis import read_results, results_path
from rig.campaigns.likelihoods import FoundRun

_SESSION = "session.json"
_ORDERED_RUNS_SQL = """
with numbered as (
  select *, coalesce(try_cast(regexp_extract(run, '[0-9]+$') as bigint), 0) as number from chosen
)
select sha256, run, sample, folder, results from numbered where results is not null
order by max(began_utc) over (partition by folder order by number, run) nulls last, folder, number, run
"""
"""Query of runs in order; runs of one session are ordered by number, even if the clock was set back."""


@dataclass(frozen=True)
class NamedRuns:
    """The runs that a command names, by folders or by a condition on an archive.

    Raises ConfigurationError for options that exclude one another or have no effect.
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
        """The runs; empty if nothing is named."""
        if self.archive is None:
            return runs_of_folders(self.folders, by_sample=self.by_sample)
        return _runs_of_archive(self.archive, self.where)


def runs_of_folders(folders: Sequence[Path], *, by_sample: bool = False) -> list[FoundRun]:
    """All runs of sessions, in the order of the folders; each folder is a contact, or with `by_sample` each
    sample.

    A folder without results of its own stands for all series in its subfolders, as one contact.

    Raises ConfigurationError for a run or folder that occurs twice, or no stated sample, and RecordError.
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
    return _without_duplicates(found)


def _sample(folder: Path) -> str:
    """The sample stated in the configuration of a session or of a table's fit."""
    runs = read_results(results_path(folder)).runs
    stated = [run.decay.session for run in runs if run.decay is not None]
    place = folder if folder.is_dir() else folder.parent
    path = results_path(folder) if stated else place / _SESSION
    try:
        session = stated[0] if stated else json.loads(path.read_bytes())["configuration"]["session"]
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
    """The runs of an archive that meet a condition, in order of their beginnings; a sample is a contact."""
    from rig.archive import selected

    found: list[FoundRun] = []
    for sha256, run, sample, folder, results in selected(archive, "*", where, _ORDERED_RUNS_SQL)[1]:
        path = Path(folder) / results
        own = [one for one in _runs(path, "", sample or path.parent.name) if one.run.sha256 == sha256]
        if not own:
            raise RecordError(f"{path}: knows no run {sha256[:8]}; rig archive update reads it again")
        found.append(replace(own[0], label=f"{path.parent.name}/{run}"))
    if not found:
        raise ConfigurationError(
            f"condition {where!r}: no run with results meets it; rig archive list shows all"
        )
    return _without_duplicates(found)


def _runs(path: Path, folder: str, contact: str) -> list[FoundRun]:
    results, sha256 = read_results(path), sha256_of(path)
    return [
        FoundRun(
            label="/".join(filter(None, (folder, Path(run.record).stem or f"run-{number}"))),
            contact=contact, results_sha256=sha256, run=run,
        )
        for number, run in enumerate(results.runs, start=1)
    ]  # fmt: skip


def _without_duplicates(runs: list[FoundRun]) -> list[FoundRun]:
    """The runs unchanged; raises ConfigurationError if a run occurs twice."""
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
