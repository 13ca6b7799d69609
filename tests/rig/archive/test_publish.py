"""`rig archive publish`: an RO-Crate that others can check, and `add` can read."""

import json
import os
import shutil
import sys
import urllib.parse
import zipfile
from pathlib import Path, PurePosixPath
from typing import Any, ClassVar

import pytest

from acquisition.record.digest import sha256_of
from acquisition.record.reader import RecordReader
from processing.errors import RecordError
from rig.archive import add_sessions
from rig.archive.eln import check_eln, unpacked
from rig.archive.store import Archive
from tests.rig.command_line import rig

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"
SAID = ("--title", "Friction of steel on K8", "--author", "Ada Example https://orcid.org/0000-0000-0000-0001")


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "series")
    add_sessions(tmp_path / "archive", [tmp_path / "runs"])
    return tmp_path / "archive"


def test_a_crate_is_described_proved_and_read_again(archive: Path, tmp_path: Path) -> None:
    crate = tmp_path / "crate"
    words = ("archive", "publish", "--where", "state = 'whole'", "-o", crate, *SAID, "--archive", archive)
    done = rig(*words)
    assert done.returncode == 0, done.stderr
    tree = {
        item["@id"]: item for item in json.loads((crate / "ro-crate-metadata.json").read_text())["@graph"]
    }
    root = tree["./"]
    assert root["name"].startswith("SIMULATED (1 of 1 runs): ")
    # a program is no organisation: only notebooks want it called one
    assert "Organization" not in {item["@type"] for item in tree.values() if isinstance(item["@type"], str)}
    other = [word if word != crate else tmp_path / "other" for word in words]
    wrong = rig(*other, "--author", "Ada https://orcid.org/0000-0000-0000-0002")
    assert (wrong.returncode, "is not an ORCID" in wrong.stderr) == (2, True)
    # one of two people with one address was lost, and a person without a name is nobody
    for author, said in (
        ("Bob https://orcid.org/0000-0000-0000-0001", "has the address of 'Ada Example"),
        ("https://orcid.org/0000-0002-1825-0097", "has no name"),
    ):
        wrong = rig(*other, "--author", author)
        assert (wrong.returncode, said in wrong.stderr) == (2, True), wrong.stderr
    assert root["license"]["@id"] == "https://spdx.org/licenses/CC-BY-4.0"
    assert root["author"]["@id"] == "https://orcid.org/0000-0000-0000-0001"
    files = {path.relative_to(crate).as_posix() for path in crate.rglob("*") if path.is_file()}
    assert files - set(tree) == {"ro-crate-metadata.json"} - set(tree)
    assert "session-1-series/inputs/calibration/lever.toml" in files
    # of the two runs only the whole one is there, in the results, too
    again = tmp_path / "again"
    assert rig("archive", "add", crate, "--archive", again).stdout.startswith("1 session added (1 run)")
    columns = ("--columns", "sha256, b, state", "--format", "json")
    listed = [
        json.loads(rig("archive", "list", "b > 0", *columns, "--archive", place).stdout)
        for place in (archive, again)
    ]
    assert listed[0] == listed[1] != []
    assert "exists already" in rig(*words).stderr
    assert not list(tmp_path.glob(".crate*"))


@pytest.mark.slow
@pytest.mark.timeout(300)
# the validator's own use of rdflib
@pytest.mark.filterwarnings("ignore:ConjunctiveGraph is deprecated:DeprecationWarning")
def test_a_crate_is_what_its_profile_asks(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Judged by roc-validator, without a network: its stored profiles, the context that rocrate holds."""
    services = pytest.importorskip("rocrate_validator.services", reason="pip install roc-validator")
    rocrate = pytest.importorskip("rocrate")
    from rocrate_validator import models
    from rocrate_validator.utils import http

    text = (Path(rocrate.__file__).parent / "data" / "ro-crate.jsonld").read_text(encoding="utf-8")

    class Answer:
        status_code = 200
        headers: ClassVar = {"Content-Type": "application/ld+json"}

        def json(self) -> Any:
            return json.loads(text)

    def get(_: object, address: str, *__: object, **___: object) -> Answer:
        assert address.startswith("https://w3id.org/ro/crate/"), f"{address}: is not here"
        return Answer()

    monkeypatch.setattr(http.HttpRequester, "get", get, raising=False)
    cite = ("--citation", "Example, A.: Friction https://doi.org/10.3390/lubricants11020088")
    for output, more, profile in (
        ("crate", (), "ro-crate-1.3"),
        ("cited", cite, "ro-crate-1.3"),
        ("friction.eln", cite, "ro-crate-1.1"),
    ):
        words = ("--where", "state = 'whole'", "-o", tmp_path / output, *SAID, *more, "--archive", archive)
        assert rig("archive", "publish", *words).returncode == 0
        crate = tmp_path / output
        if crate.suffix:
            crate = unpacked(crate)
        asked = services.ValidationSettings(
            rocrate_uri=str(crate),
            requirement_severity=models.Severity.RECOMMENDED,
            profile_identifier=profile,
            skip_availability_check=True,
        )
        found = services.validate(asked).get_issues()
        # what nobody has stated: where an author works, how to reach him, which organisation publishes
        unstated = ["affiliation", "contactPoint", "SHOULD be an `Organization`"]
        if crate.name == "friction":
            # a list also of one part, and the program as an organisation, as the ELN Consortium's schema asks
            unstated += [
                '"hasPart" SHOULD be represented as a single value',
                "organization SHOULD have a URL",
            ]
        assert not [
            str(item.message) for item in found if not any(word in str(item.message) for word in unstated)
        ]


@pytest.mark.parametrize(("pixels", "said"), [("recompressed", "recorded"), ("dropped", "dropped")])
def test_copies_are_thinned_and_of_the_same_measurement(
    archive: Path, tmp_path: Path, pixels: str, said: str
) -> None:
    """Recompressed, this short record would be no smaller: its copy stays as it is."""
    record = archive.parent / "runs" / "series" / "run-1.mcap"
    before = record.read_bytes()
    words = ("--where", "state = 'whole'", "-o", tmp_path / "crate", "--pixels", pixels, *SAID)
    done = rig("archive", "publish", *words, "--archive", archive)
    assert done.returncode == 0, done.stderr
    (copy,) = (tmp_path / "crate").rglob("*.mcap")
    assert (copy.read_bytes() == before) is (said == "recorded")
    assert record.read_bytes() == before
    with RecordReader(copy) as reader, RecordReader(record) as measured:
        assert reader.spots().tobytes() == measured.spots().tobytes()
        kept = 0 if said == "dropped" else len(list(measured.windows()))
        assert len(list(reader.windows())) == kept
    again = tmp_path / "again"
    assert rig("archive", "add", tmp_path / "crate", "--archive", again).returncode == 0
    rows = Archive(again).connection().execute("select sha256, windows, b > 0 from runs").fetchall()
    assert rows == [(sha256_of(record), said, True)]


def test_what_has_changed_is_not_published(archive: Path, tmp_path: Path) -> None:
    words = ("archive", "publish", "-o", tmp_path / "crate", "--archive", archive)
    assert "no run is meant" in rig(*words, *SAID).stderr
    assert "not an SPDX licence" in rig(*words, *SAID, "--licence", "all mine").stderr
    record = archive.parent / "runs" / "series" / "run-1.mcap"
    record.write_bytes(record.read_bytes() + b"\0")
    done = rig(*words, *SAID, "--where", "true")
    assert "has changed since it was added" in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["archive", "runs"]


def test_without_rocrate_one_line_says_what_to_install(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rocrate.rocrate", None)
    done = rig("archive", "publish", "--where", "true", "-o", tmp_path / "crate", *SAID, "--archive", archive)
    assert done.returncode == 2
    assert done.stderr == (
        f"rig: rig archive publish needs rocrate: {sys.executable} -m pip install rocrate\n"
    )


def listed(archive: Path) -> Any:
    columns = ("--columns", "sha256, run, b, u_b, state, host", "--format", "json")
    done = rig("archive", "list", "order by sha256", *columns, "--archive", archive)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_file_for_notebooks_is_as_its_format_asks_and_imported_again(tmp_path: Path) -> None:
    """Each MUST of the ELN Consortium's file format; names with spaces, two sessions."""
    shutil.copytree(SAMPLES / "series", tmp_path / "runs" / "a series")
    shutil.copytree(SAMPLES / "uncalibrated", tmp_path / "runs" / "uncalibrated")
    archive, file = tmp_path / "archive", tmp_path / "friction.eln"
    add_sessions(archive, [tmp_path / "runs"])
    words = ("archive", "publish", "--where", "true", "-o", file, *SAID, "--archive", archive)
    done = rig(*words)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{file}: 3 runs of 2 sessions\n"
    assert {path.name for path in tmp_path.iterdir()} == {"archive", "runs", "friction.eln"}
    with zipfile.ZipFile(file) as eln:
        assert eln.testzip() is None
        names = eln.namelist()
        content = {name: eln.read(name) for name in names if not name.endswith("/")}
    # one folder, called as the file, and in it the description
    assert {name.split("/")[0] for name in names} == {"friction"}
    graph = json.loads(content["friction/ro-crate-metadata.json"])
    assert graph["@context"] == "https://w3id.org/ro/crate/1.1/context"
    tree = {item["@id"]: item for item in graph["@graph"]}
    assert len(tree) == len(graph["@graph"])
    described = tree["ro-crate-metadata.json"]
    assert described["@type"] == "CreativeWork"
    assert described["about"] == {"@id": "./"}
    assert described["conformsTo"] == {"@id": "https://w3id.org/ro/crate/1.1"}
    # notebooks (SciLog) refuse a file that does not say which program wrote it
    program = tree[described["sdPublisher"]["@id"]]
    assert (program["@type"], program["name"]) == ("Organization", "optical-pendulum-rig")
    assert tree["./"]["@type"] == "Dataset"
    sessions = [tree[part["@id"]] for part in tree["./"]["hasPart"]]
    assert [item["name"] for item in sessions] == ["session-1-a series", "session-2-uncalibrated"]
    parts = set()
    for session in sessions:
        assert session["@type"] == "Dataset"
        assert f"friction/{urllib.parse.unquote(session['@id'])}" in names
        assert session["author"]["@id"] in tree
        for part in session["hasPart"]:
            item, name = tree[part["@id"]], urllib.parse.unquote(part["@id"])
            data = content[f"friction/{name}"]
            assert (item["@type"], item["contentSize"]) == ("File", str(len(data)))
            assert item["encodingFormat"]
            assert item["name"] == Path(name).name
            parts.add(f"friction/{name}")
    assert parts == content.keys() - {"friction/ro-crate-metadata.json"}
    # of another archive it is the same list, twice
    again = tmp_path / "elsewhere" / "again"
    shutil.copytree(file.parent, again.parent, ignore=lambda *_: {"archive", "runs"})
    copy = again.parent / file.name
    assert rig("archive", "add", copy, "--archive", again).stdout.startswith("2 sessions added (3 runs)")
    assert "2 known already" in rig("archive", "add", copy, "--archive", again).stdout
    assert listed(again) == listed(archive) != []
    assert "exists already and is not overwritten" in rig(*words).stderr


def sha256_in(metadata: bytes, name: str) -> bytes:
    (digest,) = (one["sha256"] for one in json.loads(metadata)["@graph"] if one["@id"] == name)
    return str(digest).encode()


def test_a_damaged_or_foreign_file_for_notebooks_is_refused(archive: Path, tmp_path: Path) -> None:
    good = tmp_path / "good.eln"
    words = ("--where", "state = 'whole'", "-o", good, *SAID, "--archive", archive)
    assert rig("archive", "publish", *words).returncode == 0
    with zipfile.ZipFile(good) as eln:
        content = {name: eln.read(name) for name in eln.namelist() if not name.endswith("/")}
    record = next(name for name in content if name.endswith(".mcap"))

    def said(files: dict[str, bytes] | bytes) -> str:
        bad = tmp_path / "bad.eln"
        if isinstance(files, bytes):
            bad.write_bytes(files)
        else:
            with zipfile.ZipFile(bad, "w") as eln:
                for name, data in files.items():
                    eln.writestr(name, data)
        done = rig("archive", "add", bad, "--archive", tmp_path / "other")
        assert (done.returncode != 0, done.stdout, done.stderr.count("\n")) == (True, "", 1)
        assert {path.name for path in tmp_path.iterdir()} <= {"archive", "runs", "good.eln", "bad.eln"}
        return done.stderr

    data = good.read_bytes()
    place = data.index(content[record]) + len(content[record]) // 2
    assert "cannot be read: Bad CRC-32" in said(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
    assert "is not an .eln file" in said(data[: len(data) // 2])
    assert "does not have the hash" in said({**content, record: content[record] + b"\0"})
    assert "is described and not in it" in said({k: v for k, v in content.items() if k != record})
    assert "it must hold one folder" in said({**content, "more/a.txt": b""})
    assert "it must hold one folder" in said({"good/a.txt": b""})
    assert "is not in a folder" in said({**content, "a.txt": b""})
    for name in ("good/../../a.txt", "/good/a.txt", "good/C:/a.txt", "good/..\\a.txt"):
        assert "would lie outside" in said({**content, name: b""})
    metadata = "good/ro-crate-metadata.json"
    for text in (b"", b"[]", b'{"@graph": [{"@id": 1}]}', b"\xff", b"[" * 100_000):
        assert "is not the description" in said({**content, metadata: text})
    assert "'a' in it is a file and a folder" in said({**content, "good/a": b"", "good/a/b": b""})
    # digests are as good in capitals, as other notebooks write them
    shouted = tmp_path / "capitals.eln"
    with zipfile.ZipFile(shouted, "w") as eln:
        for name, each in content.items():
            digest = sha256_in(content[metadata], record.removeprefix("good/"))
            eln.writestr(name, each.replace(digest, digest.upper()) if name == metadata else each)
    assert rig("archive", "add", shouted, "--archive", tmp_path / "other").returncode == 0
    # macOS adds a folder beside it and files in it
    zipped = tmp_path / "zipped.eln"
    with zipfile.ZipFile(zipped, "w") as eln:
        for name, each in content.items():
            eln.writestr(name, each)
            eln.writestr(f"__MACOSX/{PurePosixPath(name).parent}/._{PurePosixPath(name).name}", b"Mac OS X")
        for name in (".DS_Store", "good/.DS_Store", str(PurePosixPath(record).with_name(".DS_Store"))):
            eln.writestr(name, b"Bud1")
    check_eln(zipped)
    assert "known already" in rig("archive", "add", zipped, "--archive", tmp_path / "other").stdout
    unpacked = {
        path.relative_to(tmp_path / "zipped").as_posix() for path in (tmp_path / "zipped").rglob("*.*")
    }
    assert unpacked == {name.removeprefix("good/") for name in content if "." in PurePosixPath(name).name}
    # a folder of its name that is another one stays
    (tmp_path / "good").mkdir()
    (tmp_path / "good" / "mine.txt").write_text("kept")
    done = rig("archive", "add", good, "--archive", tmp_path / "other")
    assert "holds something else; rename one" in done.stderr
    assert os.listdir(tmp_path / "good") == ["mine.txt"]
    # what has no description was not written by publish
    with zipfile.ZipFile(good, "a") as eln:
        eln.writestr("good/stray.txt", b"")
    with pytest.raises(RecordError, match=r"stray\.txt does not match the description"):
        check_eln(good)
