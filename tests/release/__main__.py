"""One command for a release: ``make release VERSION=1.2.3``.

Everything is made in a clone: heading of the changelog, commit, tag, sdist, wheel, SBOM, site and sums. The
tree gets commit and tag only when all of that is there, and nothing is pushed: that publishes.
"""

import argparse
import shutil
import sys
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from tests.release.files import bill_of_materials, build, refuse_difference, site, write_sums
from tests.release.refusals import (
    Refused,
    git,
    refuse_changes,
    refuse_failures,
    refuse_version,
    refuse_what_is_missing,
)

TREE = Path(__file__).resolve().parents[2]
CHECKS = (("make", "lint"), ("make", "docs"), ("make", "test"))


def release(tree: Path, version: str, checks: Sequence[Sequence[str]], day: str) -> Path:
    """Make a release of the tree's commit; returns the folder of its files.

    Raises Refused, after which the tree is as it was.
    """
    refuse_version(tree, version)
    refuse_changes(tree)
    files = tree / "dist" / version
    if files.exists():
        raise Refused(f"{files}: exists already, of a release that was not tagged; remove it")
    refuse_what_is_missing(tree)
    refuse_failures(tree, checks)
    refuse_changes(tree)
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "clone"
        git(tree, "clone", "--quiet", str(tree), str(clone))
        _commit_and_tag(tree, clone, version, day)
        made = Path(folder) / "files"
        first = build(clone, made)
        refuse_difference(first, build(clone, Path(folder) / "again"))
        if not any(path.name == f"optical_pendulum_rig-{version}.tar.gz" for path in first):
            raise Refused(f"the tag gave other names: {', '.join(path.name for path in first)}")
        bill_of_materials(clone, version, made / f"optical_pendulum_rig-{version}.cdx.json")
        site(clone, made / f"optical_pendulum_rig-{version}-site.tar.gz")
        write_sums(made)
        _hand_over(tree, clone, made, version)
    return files


def _hand_over(tree: Path, clone: Path, made: Path, version: str) -> None:
    """Give the tree files, tag and commit: all or none, also where the tree has moved on meanwhile."""
    files = tree / "dist" / version
    try:
        shutil.copytree(made, files)
        git(tree, "fetch", "--quiet", str(clone), f"refs/tags/v{version}:refs/tags/v{version}")
        git(tree, "merge", "--quiet", "--ff-only", f"v{version}")
    except BaseException:
        shutil.rmtree(files, ignore_errors=True)
        if git(tree, "tag", "--list", f"v{version}"):
            git(tree, "tag", "--delete", f"v{version}")
        raise


def part_of(changelog: str, version: str) -> str:
    """What the changelog says of a version."""
    after = changelog.partition(f"\n## {version}, ")[2].partition("\n")[2]
    return after.partition("\n## ")[0].strip()


def _commit_and_tag(tree: Path, clone: Path, version: str, day: str) -> None:
    changelog = clone / "CHANGELOG.md"
    text = changelog.read_text(encoding="utf-8")
    text = text.replace(f"\n## {version}, not yet released\n", f"\n## {version}, {day}\n")
    changelog.write_text(text, encoding="utf-8")
    for key in ("user.name", "user.email"):
        git(clone, "config", key, git(tree, "config", key))
    git(clone, "commit", "--quiet", "--all", "--message", f"Version {version}")
    # lines of the changelog that begin with # would be comments
    message = f"Version {version}\n\n{part_of(text, version)}"
    git(clone, "tag", "--annotate", f"v{version}", "--cleanup=verbatim", "--message", message)


def main() -> None:
    """Release, or only build the files of a commit that has its tag, as the workflow that publishes does."""
    parser = argparse.ArgumentParser(prog="python -m tests.release", description=__doc__)
    parser.add_argument("version", help="three numbers")
    parser.add_argument("--files", type=Path, help="of a tagged commit: build sdist and wheel there, no more")
    words = parser.parse_args()
    try:
        if words.files is not None:
            if git(TREE, "describe", "--tags", "--exact-match") != f"v{words.version}":
                raise Refused(f"this commit is not v{words.version}")
            refuse_changes(TREE)
            with tempfile.TemporaryDirectory() as again:
                refuse_difference(build(TREE, words.files), build(TREE, Path(again)))
            return
        day = datetime.now(UTC).strftime("%Y-%m-%d")
        files = release(TREE, words.version, CHECKS, day)
    except Refused as refusal:
        sys.exit(f"no release: {refusal}")
    print(f"{files}: {', '.join(sorted(path.name for path in files.iterdir()))}")
    print(f"to publish it: git push --atomic origin HEAD v{words.version}")


if __name__ == "__main__":
    main()
