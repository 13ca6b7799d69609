"""`rig archive publish`: runs, their results and inputs as an RO-Crate, a folder that describes itself."""

import datetime
import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from acquisition.record.digest import sha256_of
from acquisition.record.proof import Thinning, measured_sha256_of
from acquisition.record.reader import RecordReader
from acquisition.record.whole_file import folder_being_written
from processing.errors import ConfigurationError, MissingPackage, RecordError
from rig.analysis import read_results, results_path, write_results
from rig.archive.blind import sealed
from rig.archive.chosen import chosen_runs, simulated_among
from rig.archive.thinning import thin_copy
from rig.sealing import refuse_blind

_INPUTS = ("configuration.", "calibration/", "record.md")
_MEDIA_TYPES = {
    ".mcap": "application/octet-stream",
    ".json": "application/json",
    ".toml": "application/toml",
    ".md": "text/markdown",
}
_MEANINGS = {
    ".mcap": "record of a run: spots, half-cycles, events, pixels",
    "results.json": "results of the analysis of the records beside it",
    "session.json": "the session's runs and their states",
    ".toml": "configuration or calibration, as the record holds it",
    ".md": "what the record's topics and fields mean",
}


class Statement(NamedTuple):
    """What is said of a publication: its title, its licence (name of SPDX), who made it, what to cite."""

    title: str
    licence: str
    authors: Sequence[str]
    citation: str = ""


def publish_runs(
    archive: Path,
    names: Sequence[str],
    where: str,
    output: Path,
    statement: Statement,
    pixels: Thinning | None = None,
) -> str:
    """Write runs that are named or meet a condition as an RO-Crate into a new folder; says what it holds.

    One folder a session, with its records, their results, and configuration and calibrations as the records
    hold them. The folder appears when everything in it is proved: each record has the hash that the archive
    knows, and every file is described. With `pixels` those are recompressed or dropped, in the copies alone,
    as `rig archive thin` does it: the copy states the hash of the record as it was measured.

    Raises ConfigurationError without the package rocrate, for no runs, or what is stated wrongly; RecordError
    where a record is not here, has changed, or must not be thinned.
    """
    try:
        from rocrate.rocrate import ROCrate
    except ImportError:
        raise MissingPackage("rig archive publish", "rocrate") from None
    if not re.fullmatch(r"[A-Za-z0-9.+-]+", statement.licence):
        raise ConfigurationError(f"--licence {statement.licence!r}: is no name of SPDX, such as CC-BY-4.0")
    if not statement.title.strip() or not statement.authors:
        raise ConfigurationError("a publication needs a title and an author: --title TEXT --author NAME")
    for author in statement.authors:
        if "orcid" in author.lower() and not _has_orcid(author):
            raise ConfigurationError(
                f"--author {author!r}: is no ORCID; copy it from the person's page, as "
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
    try:
        with folder_being_written(output) as beside:
            for number, (folder, records) in enumerate(sorted(by_folder.items()), 1):
                target = beside / f"session-{number}-{folder.name}"
                _copy_session(folder, records, target)
                if pixels is not None:
                    for record, sha256 in records.items():
                        copy, rule = target / record.name, f"{pixels} in a publication"
                        thin_copy(archive, record, copy, sha256, pixels, rule)
            _describe(ROCrate(), beside, statement, simulated_among(archive, runs), len(runs))
            _check(ROCrate(beside), beside)
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
        if measured_sha256_of(copy) != sha256:
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


def _describe(crate: Any, folder: Path, statement: Statement, simulated: int, runs: int) -> None:
    """Name every file, and state title, licence, authors, what to cite, and how many runs are simulated."""
    from rocrate.model.contextentity import ContextEntity
    from rocrate.model.person import Person

    invented = f"SIMULATED ({simulated} of {runs} runs): " if simulated else ""
    crate.name = f"{invented}{statement.title}"
    crate.description = (
        f"{crate.name}: records (MCAP) of an optical pendulum, results of their analysis (JSON), "
        "configuration and calibrations. rig archive add reads the folder."
    )
    crate.datePublished = datetime.datetime.now(datetime.UTC).date().isoformat()
    licence = f"https://spdx.org/licenses/{statement.licence}"
    said = {"@type": "CreativeWork", "name": statement.licence, "url": licence}
    said["description"] = f"The licence {statement.licence}, as SPDX has it"
    crate.license = crate.add(ContextEntity(crate, licence, said))
    authors = [
        crate.add(Person(crate, _identifier(text, place), {"name": text.partition("http")[0].strip(" ,")}))
        for place, text in enumerate(statement.authors, 1)
    ]
    crate.root_dataset["author"] = authors if len(authors) > 1 else authors[0]
    crate.root_dataset["publisher"] = authors[0]
    # what is cited is known by its address, and a text by which to credit is no citation
    crate.root_dataset["creditText"] = statement.citation or (
        f"{', '.join(text.partition('http')[0].strip(' ,') for text in statement.authors)}: {statement.title}"
    )
    if address := re.search(r"https?://\S+", statement.citation):
        article = {"@type": "ScholarlyArticle", "name": statement.citation}
        crate.root_dataset["citation"] = crate.add(ContextEntity(crate, address[0], article))
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            described = {
                "name": path.name,
                "contentSize": str(path.stat().st_size),
                "description": _MEANINGS.get(path.name)
                or _MEANINGS.get(path.suffix, "an input of the session"),
                "encodingFormat": _MEDIA_TYPES.get(path.suffix, "application/octet-stream"),
                "sha256": sha256_of(path),
            }
            crate.add_file(path, path.relative_to(folder).as_posix(), properties=described)
    crate.write(folder)


def _identifier(author: str, place: int) -> str:
    """The address of a person (ORCID) where one is stated."""
    found = re.search(r"https?://\S+", author)
    return found[0] if found else f"#author-{place}"


def _has_orcid(author: str) -> bool:
    """Whether the address is that of an ORCID whose last character checks the others (ISO 7064, 11-2)."""
    found = re.search(r"https?://orcid\.org/(\d{4})-(\d{4})-(\d{4})-(\d{3})([\dX])$", author.strip())
    if found is None:
        return False
    total = 0
    for digit in "".join(found.groups()[:4]):
        total = 2 * (total + int(digit))
    return found[5] == "0123456789X"[(12 - total % 11) % 11]


def _check(crate: Any, folder: Path) -> None:
    """Every file is described, and everything described is there with the hash that is stated."""
    described = {entity.id: entity.get("sha256") for entity in crate.data_entities if entity.type == "File"}
    there = {
        path.relative_to(folder).as_posix(): path
        for path in folder.rglob("*")
        if path.is_file() and path.name not in ("ro-crate-metadata.json", "ro-crate-preview.html")
    }
    wrong = sorted(set(described) ^ set(there))
    wrong += [name for name, path in there.items() if described.get(name) != sha256_of(path)]
    if wrong:
        raise RecordError(f"{folder}: {wrong[0]} is not as the description of the crate says")
