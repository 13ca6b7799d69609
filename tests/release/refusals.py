"""What must hold before anything is released; each refusal is one line."""

import importlib.util
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

_VERSION = re.compile(r"\d+\.\d+\.\d+")
_PART = re.compile(r"^## (\d+\.\d+\.\d+), not yet released$", re.MULTILINE)


class Refused(Exception):
    """Why there is no release."""


def git(tree: Path, *words: str) -> str:
    """What git prints; raises Refused with its own words where it fails."""
    done = subprocess.run(["git", "-C", tree, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise Refused(f"git {words[0]}: {done.stderr.strip() or done.returncode}")
    return done.stdout.strip()


def refuse_version(tree: Path, version: str) -> None:
    """Refuse what is no three numbers, not above every tag, or not what CHANGELOG.md names."""
    if not _VERSION.fullmatch(version):
        raise Refused(f"version {version!r}: three numbers, as 1.2.3")
    tags = git(tree, "tag", "--list", "v*").split()
    if f"v{version}" in tags:
        raise Refused(f"v{version}: the tag exists")
    newest = max((_numbers(tag[1:]) for tag in tags if _VERSION.fullmatch(tag[1:])), default=(0, 0, 0))
    if _numbers(version) < newest:
        raise Refused(f"version {version}: {'.'.join(map(str, newest))} is released already")
    stated = _PART.findall((tree / "CHANGELOG.md").read_text(encoding="utf-8"))
    if stated != [version]:
        named = " and ".join(stated) or "none"
        raise Refused(f"CHANGELOG.md: needs one part '## {version}, not yet released'; it has {named}")


def refuse_changes(tree: Path) -> None:
    """Refuse a tree with changes, or files, that no commit has."""
    changed = git(tree, "status", "--porcelain").splitlines()
    if changed:
        raise Refused(f"{len(changed)} changes are not committed, the first: {changed[0].strip()}")


def refuse_what_is_missing(tree: Path) -> None:
    """Refuse, before the long checks, for want of a maker of the bill of materials or a name for the tag."""
    if importlib.util.find_spec("cyclonedx_py") is None:
        raise Refused("the bill of materials needs cyclonedx-bom: pip install '.[release]'")
    for key in ("user.name", "user.email"):
        # 1 where it is not set, with no words at all
        if subprocess.run(["git", "-C", tree, "config", key], capture_output=True, check=False).returncode:
            raise Refused(f"git knows no {key}, who releases: git config {key} ...")


def refuse_failures(tree: Path, checks: Sequence[Sequence[str]]) -> None:
    """Run commands, one after the other; refuse at the first that fails."""
    for words in checks:
        if subprocess.run(words, cwd=tree, check=False).returncode:
            raise Refused(f"{' '.join(words)}: failed")


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(map(int, version.split(".")))
