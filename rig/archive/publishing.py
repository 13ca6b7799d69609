"""`rig archive publish`: runs, their results and inputs as an RO-Crate, a folder that describes itself."""

import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from acquisition.record.whole_file import being_written, folder_being_written, folder_beside
from processing.errors import ConfigurationError, MissingPackage, RecordError
from rig.analysis import read_results, results_path, write_results
from rig.archive.blind import sealed
from rig.archive.chosen import chosen_runs, simulated_among
from rig.archive.crates import ELN_CRATE, Statement, check_crate, describe
from rig.archive.eln import check_eln, is_eln, write_eln
from rig.sealing import refuse_blind

_INPUTS = ("configuration.", "calibration/", "record.md")


def publish_runs(
    archive: Path,
    names: Sequence[str],
    where: str,
    output: Path,
    statement: Statement,
) -> str:
    """Write runs that are named or meet a condition as an RO-Crate into a new folder; says what it holds.

    An `output` that ends in .eln is a file instead, which electronic laboratory notebooks read.

    One folder a session, with its records, their results, and configuration and calibrations as the records
    hold them. The output appears when everything in it is proved: each record has the hash that the archive
    knows, and every file is described.

    Raises ConfigurationError without the package rocrate, for no runs, or what is stated wrongly; RecordError
    where a record is not here or has changed.
    """
    try:
        from rocrate.rocrate import ROCrate
    except ImportError:
        raise MissingPackage("rig archive publish", "rocrate") from None
    if not re.fullmatch(r"[A-Za-z0-9.+-]+", statement.licence):
        raise ConfigurationError(
            f"--licence {statement.licence!r}: is not an SPDX licence identifier, such as CC-BY-4.0"
        )
    if not statement.title.strip() or not statement.authors:
        raise ConfigurationError("a publication needs a title and an author: --title TEXT --author NAME")
    known: dict[str, str] = {}
    for author in statement.authors:
        if not author.partition("http")[0].strip(" ,"):
            raise ConfigurationError(f"--author {author!r}: has no name; write it before the address")
        if (address := author[author.find("http") :] if "http" in author else "") in known:
            raise ConfigurationError(f"--author {author!r}: has the address of {known[address]!r}")
        if address:
            known[address] = author
        if "orcid" in author.lower() and not _has_orcid(author):
            raise ConfigurationError(
                f"--author {author!r}: is not an ORCID; copy it from the person's page, as "
                "https://orcid.org/0000-0002-1825-0097"
            )
    if sealed(archive) is not None:
        raise ConfigurationError(
            f"{archive}: is blind, and a publication holds true values; unblind it first"
        )
    runs = chosen_runs(archive, names, where)
    for record in runs.values():
        refuse_blind(record, "a publication")
    if not runs:
        raise ConfigurationError("no run is meant: name one, or state a condition that one meets")
    by_folder: dict[Path, dict[Path, str]] = {}
    for sha256, record in runs.items():
        by_folder.setdefault(record.parent, {})[record] = sha256
    simulated = simulated_among(archive, runs)

    def fill(target: Path, crate: Any) -> None:
        for number, (folder, records) in enumerate(sorted(by_folder.items()), 1):
            session = target / f"session-{number}-{folder.name}"
            _copy_session(folder, records, session)
        describe(crate, target, statement, simulated, len(runs))
        check_crate(target)

    try:
        if is_eln(output):
            with being_written(output) as beside, folder_beside(output) as content:
                fill(content, ROCrate(version=ELN_CRATE))
                write_eln(content, output.stem, beside)
                check_eln(beside)
        else:
            with folder_being_written(output) as beside:
                fill(beside, ROCrate())
    except FileExistsError:
        raise ConfigurationError(
            f"{output}: exists already and is not overwritten; choose another name"
        ) from None
    except OSError as error:
        raise RecordError(f"{output}: cannot be written: {error.strerror or error}") from None
    return f"{output}: {len(runs)} run{'s' if len(runs) != 1 else ''} of {len(by_folder)} sessions"


def _copy_session(folder: Path, records: dict[Path, str], target: Path) -> None:
    target.mkdir(parents=True)
    for number, (record, sha256) in enumerate(sorted(records.items())):
        if not record.is_file():
            raise RecordError(f"{record}: is not here; publish on the computer where it lies")
        copy = target / record.name
        shutil.copyfile(record, copy)
        if sha256_of(copy) != sha256:
            raise RecordError(f"{record}: has changed since it was added; rig archive add")
        if number == 0:
            _copy_inputs(copy, target / "inputs")
    source = results_path(folder)
    if source.is_file():
        results = read_results(source)
        kept = tuple(run for run in results.runs if run.sha256 in records.values())
        if len(kept) == len(results.runs):
            shutil.copyfile(source, target / "results.json")
        elif kept:
            # the series speaks of runs that are not published
            write_results(target / "results.json", replace(results, runs=kept, series=None))
    if (folder / "session.json").is_file():
        shutil.copyfile(folder / "session.json", target / "session.json")


def _copy_inputs(record: Path, target: Path) -> None:
    with RecordReader(record) as reader:
        for name, data in sorted(reader.attachments.items()):
            if name.startswith(_INPUTS) and ".." not in Path(name).parts:
                (target / name).parent.mkdir(parents=True, exist_ok=True)
                (target / name).write_bytes(data)


def _has_orcid(author: str) -> bool:
    """Whether the address is that of an ORCID whose last character checks the others (ISO 7064, 11-2)."""
    found = re.search(r"https?://orcid\.org/(\d{4})-(\d{4})-(\d{4})-(\d{3})([\dX])$", author.strip())
    if found is None:
        return False
    total = 0
    for digit in "".join(found.groups()[:4]):
        total = 2 * (total + int(digit))
    return found[5] == "0123456789X"[(12 - total % 11) % 11]
