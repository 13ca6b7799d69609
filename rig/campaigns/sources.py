"""The runs of a campaign: of folders, or of an archive's rows that meet a condition."""

from collections.abc import Sequence
from pathlib import Path

from acquisition.record.digest import sha256_of
from processing.errors import ConfigurationError, RecordError
from rig.analysis import read_results, results_path
from rig.campaigns.likelihoods import FoundRun


def runs_of_folders(folders: Sequence[Path]) -> list[FoundRun]:
    """All runs of sessions, in the order in which they are named; each folder is a contact.

    Raises ConfigurationError where a run or a folder is there twice, RecordError where one cannot be read.
    """
    names = [folder.resolve().name if folder.is_dir() else folder.resolve().parent.name for folder in folders]
    found: list[FoundRun] = []
    for folder, name in zip(folders, names, strict=True):
        label = name if names.count(name) == 1 else str(folder)
        found += _runs(results_path(folder), label, label)
    return _different(found)


def runs_of_archive(archive: Path, where: str) -> list[FoundRun]:
    """The runs of an archive that meet a condition, in the order of their beginnings; a sample is a contact.

    Raises ConfigurationError for an archive whose values are hidden, for a condition that no run meets.
    """
    from rig.archive import is_sealed, results_of_runs

    if is_sealed(archive):
        raise ConfigurationError(
            f"{archive}: is blind: a campaign would show what is hidden; rig archive unblind first"
        )
    found: list[FoundRun] = []
    for row in results_of_runs(archive, where):
        if row.results is None:
            continue
        label = f"{row.results.parent.name}/{row.run}"
        runs = _runs(row.results, "", row.sample or row.results.parent.name)
        own = [one for one in runs if one.run.sha256 == row.sha256]
        if not own:
            raise RecordError(
                f"{row.results}: knows no run {row.sha256[:8]}; rig archive add renews the catalogue"
            )
        found.append(
            FoundRun(
                label=label, contact=own[0].contact, results_sha256=own[0].results_sha256, run=own[0].run
            )
        )
    if not found:
        raise ConfigurationError(
            f"condition {where!r}: no run with results meets it; rig archive list shows all"
        )
    return _different(found)


def _runs(path: Path, folder: str, contact: str) -> list[FoundRun]:
    results = read_results(path)
    sha256 = sha256_of(path)
    return [
        FoundRun(
            label="/".join(filter(None, (folder, Path(run.record).stem or f"run-{number}"))),
            contact=contact,
            results_sha256=sha256,
            run=run,
        )
        for number, run in enumerate(results.runs, start=1)
    ]


def _different(runs: list[FoundRun]) -> list[FoundRun]:
    """The runs, of which none may be there twice: it counts once."""
    seen: dict[str, str] = {}
    for one in runs:
        if one.run.sha256 and seen.setdefault(one.run.sha256, one.label) != one.label:
            raise ConfigurationError(
                f"{one.label}: is the run of {seen[one.run.sha256]} (same hash), which counts once"
            )
    return runs
