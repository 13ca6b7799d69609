"""A folder as an RO-Crate: every file described with its hash, and proved by its description."""

import datetime
import json
import re
import urllib.parse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from acquisition.record.digest import sha256_of
from processing.errors import RecordError
from rig.instrument import versions

METADATA = "ro-crate-metadata.json"
ELN_CRATE = "1.1"
"""Version of RO-Crate in which files .eln are described, and by which their readers judge."""
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


def describe(crate: Any, folder: Path, statement: Statement, simulated: int, runs: int) -> None:
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
    if crate.version == ELN_CRATE:
        # notebooks refuse a file .eln that does not say which program wrote it, as an organisation
        program = {
            "@type": "Organization",
            "name": "optical-pendulum-rig",
            "description": f"The program that wrote this crate, version {versions()['optical-pendulum-rig']}",
        }
        crate.metadata["sdPublisher"] = crate.add(ContextEntity(crate, "#optical-pendulum-rig", program))
    sessions = []
    for session in sorted(path for path in folder.iterdir() if path.is_dir()):
        files = [
            crate.add_file(path, path.relative_to(folder).as_posix(), properties=_of_file(path))
            for path in sorted(session.rglob("*"))
            if path.is_file()
        ]
        records = ", ".join(path.name for path in sorted(session.glob("*.mcap")))
        said = {
            "name": session.name,
            "description": f"A session: its records {records}, and what was made of them",
        }
        sessions.append(crate.add_dataset(None, session.name, properties=said))
        sessions[-1]["author"] = crate.root_dataset["author"]
        sessions[-1]["hasPart"] = _parts(crate, files)
    # a file is part of its session, and a notebook takes what is part of the whole for an entry of its own
    crate.root_dataset["hasPart"] = _parts(crate, sessions)
    crate.write(folder)


def _parts(crate: Any, entities: Sequence[Any]) -> Any:
    """A single part as it is from RO-Crate 1.2 on, and in a list where a notebook looks for a list."""
    return entities if len(entities) != 1 or crate.version == ELN_CRATE else entities[0]


def _of_file(path: Path) -> dict[str, str]:
    return {
        "name": path.name,
        "contentSize": str(path.stat().st_size),
        "description": _MEANINGS.get(path.name) or _MEANINGS.get(path.suffix, "an input of the session"),
        "encodingFormat": _MEDIA_TYPES.get(path.suffix, "application/octet-stream"),
        "sha256": sha256_of(path),
    }


def _identifier(author: str, place: int) -> str:
    """The address of a person (ORCID) where one is stated."""
    found = re.search(r"https?://\S+", author)
    return found[0] if found else f"#author-{place}"


def described_files(metadata: bytes, where: str) -> dict[str, str | None]:
    """The files that a crate's metadata describe, by their path in it, with the SHA-256 that is stated.

    Raises RecordError for what is no such metadata.
    """
    found: dict[str, str | None] = {}
    try:
        for entity in json.loads(metadata)["@graph"]:
            kinds = entity["@type"] if isinstance(entity["@type"], list) else [entity["@type"]]
            name = urllib.parse.unquote(entity["@id"]).removeprefix("./")
            # what lies on the web is described, too
            if "File" in kinds and "://" not in name:
                sha256 = entity.get("sha256")
                found[name] = sha256 and sha256.lower()
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise RecordError(f"{where}: {METADATA} is not the description of an RO-Crate: {error!r}") from None
    return found


def check_crate(folder: Path) -> None:
    """Every file is described, and everything described is there with the hash that is stated."""
    described = described_files((folder / METADATA).read_bytes(), str(folder))
    there = {
        path.relative_to(folder).as_posix(): sha256_of(path)
        for path in folder.rglob("*")
        if path.is_file() and path != folder / METADATA
    }
    check_described(described, there, str(folder))


def check_described(described: dict[str, str | None], there: dict[str, str], where: str) -> None:
    """Raise RecordError unless the files that are there are those that are described, with these hashes."""
    wrong = sorted({*described, *there} - {name for name in there if described.get(name) == there[name]})
    if wrong:
        raise RecordError(f"{where}: {wrong[0]} does not match the description in the crate")
