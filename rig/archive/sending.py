"""What is new in the copy of a remote archive is sent to where it lies, in an order that a kill may cut."""

from collections.abc import Sequence

from processing.errors import RecordError
from rig.archive.copied import AT_ONCE, Copy
from rig.archive.facts import FOLDER as FACTS
from rig.archive.facts import FactLog
from rig.archive.manifest import MANIFEST
from rig.archive.proved import prove


def send(copy: Copy) -> None:
    """Write there what is new here; of what was taken away here only merged files, which are derived.

    Raises RecordError where it cannot be written, or is not there as it was sent.
    """
    here, seen = copy.names(), copy.seen()
    new = sorted(here - seen, key=_order)
    sent: list[str] = []
    if new and MANIFEST not in new:
        copy.bucket.try_to_write_over((copy.folder / MANIFEST).read_bytes())
    while new:
        name = new.pop(0)
        data = (copy.folder / name).read_bytes()
        prove(copy.folder / name, name, data)
        # a request that was repeated meets what it has written
        if copy.bucket.create(name, data) or copy.bucket.read([name]).get(name) == data:
            sent.append(name)
        elif name.startswith(f"{FACTS}/"):
            again = _after_theirs(copy, [name, *(other for other in new if other.startswith(f"{FACTS}/"))])
            new = sorted({*new, *again} & copy.names(), key=_order)
        else:
            # who was there first is right
            (copy.folder / name).unlink()
            copy.bring([name])
    _prove_sent(copy, sent)
    for name in seen - here:
        if name.startswith("merged/"):
            copy.bucket.take_away(name)
    copy.remember(copy.names())


def _prove_sent(copy: Copy, names: Sequence[str]) -> None:
    """Raise RecordError where a file that was taken is not there as it was sent."""
    for first in range(0, len(names), AT_ONCE):
        part = names[first : first + AT_ONCE]
        found = copy.bucket.read(part)
        for name in part:
            if name in found and found[name] != (copy.folder / name).read_bytes():
                raise RecordError(
                    f"{copy.bucket.url}/{name}: is not there as it was sent: somebody overwrote it, or the "
                    "server changed it; rig archive check --repair corrects it"
                )


def _after_theirs(copy: Copy, names: Sequence[str]) -> set[str]:
    """Give facts that were not sent numbers behind those that somebody else has sent meanwhile.

    So the copies of two users of one computer tell one history, in the order in which they were sent.
    """
    log = FactLog(copy.folder)
    ours = log.entries(name.rpartition("/")[2] for name in names)
    for entry in ours:
        (log.folder / entry.name).unlink()
    copy.bring(sorted(copy.bucket.names(FACTS) - copy.names()))
    log = FactLog(copy.folder)
    return {f"{FACTS}/{log.write(entry.facts)}" for entry in ours}


def _order(name: str) -> tuple[int, str]:
    """What others follow from first: no state without the first fact, no fact without its state."""
    if name == MANIFEST:
        return 0, name
    if name.startswith(f"{FACTS}/"):
        return (1 if name.endswith("-00000001.facts") else 3), name
    return (4 if name.startswith("merged/") else 2), name
