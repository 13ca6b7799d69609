"""The files of a release: sdist and wheel, the same bytes whoever builds them, SBOM, site, sums."""

import gzip
import hashlib
import io
import json
import os
import subprocess
import sys
import tarfile
from pathlib import Path

from tests.release.refusals import Refused, git

SUMS = "SHA256SUMS"


def build(tree: Path, folder: Path) -> list[Path]:
    """Build sdist and wheel of what is committed; their times are that of the commit."""
    _run(tree, "-m", "hatchling", "build", "-d", str(folder), "-t", "sdist", "-t", "wheel")
    return sorted(folder.iterdir())


def refuse_difference(first: list[Path], second: list[Path]) -> None:
    """Refuse two builds that are not the same in every byte."""
    names = [[path.name for path in built] for built in (first, second)]
    if names[0] != names[1]:
        raise Refused(f"two builds have other files: {names[0]} and {names[1]}")
    for one, other in zip(first, second, strict=True):
        if digest(one) != digest(other):
            raise Refused(f"{one.name}: two builds of the same commit differ")


def bill_of_materials(tree: Path, version: str, path: Path) -> None:
    """What the program is made of, by the pins it is tested with, as CycloneDX."""
    pins = ["--pyproject", "pyproject.toml", "constraints.txt"]
    form = ["--output-reproducible", "--sv", "1.6", "--of", "JSON", "-o", str(path.absolute())]
    _run(tree, "-W", "ignore", "-m", "cyclonedx_py", "requirements", *form, *pins)
    bill = json.loads(path.read_text(encoding="utf-8"))
    # which pyproject.toml does not state, because the tag does
    bill["metadata"]["component"]["version"] = version
    path.write_text(json.dumps(bill, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def site(tree: Path, path: Path) -> None:
    """The documents as a site, every link of it checked, in one archive."""
    built = tree / "build" / "site"
    _run(
        tree,
        *["-m", "sphinx", "-E", "-W", "--keep-going", "-q", "-c", "docs/site", "-b", "html", "."],
        str(built),
    )
    _run(tree, "docs/site/check_links.py", str(built))
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        for file in sorted(built.rglob("*")):
            if file.is_file() and ".doctrees" not in file.parts:
                entry = tarfile.TarInfo(f"site/{file.relative_to(built).as_posix()}")
                entry.size, entry.mtime = file.stat().st_size, int(committed_s(tree))
                with file.open("rb") as content:
                    archive.addfile(entry, content)
    path.write_bytes(gzip.compress(packed.getvalue(), mtime=0))


def write_sums(folder: Path) -> Path:
    """The sums of all files in a folder, as sha256sum checks them."""
    lines = [f"{digest(path)}  {path.name}\n" for path in sorted(folder.iterdir()) if path.name != SUMS]
    (folder / SUMS).write_text("".join(lines), encoding="utf-8")
    return folder / SUMS


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def committed_s(tree: Path) -> str:
    """When the commit was made, in seconds: the time of all that is built of it."""
    return git(tree, "log", "-1", "--format=%ct")


def _run(tree: Path, *words: str) -> None:
    """Run this Python in a tree, whose packages come before installed ones."""
    environment = {**os.environ, "SOURCE_DATE_EPOCH": committed_s(tree), "PYTHONPATH": str(tree)}
    done = subprocess.run(
        [sys.executable, *words], cwd=tree, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise Refused(f"{' '.join(words[:2])}: failed: {(done.stderr or done.stdout).strip()}")
