"""Files of earlier schemas in today's keys: a function for each step from one schema to the next.

A configuration, like a results file, states the number of its schema under `SCHEMA_KEY`; one that a program
wrote without a number is of the first. A key that goes is named in `GONE`, and a step drops it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import reduce
from typing import Any, Final

from processing.errors import ConfigurationError

Tree = Mapping[str, Any]
Step = Callable[[Tree], Tree]
SCHEMA_KEY: Final = "schema"

GONE: Final[Mapping[str, str]] = {
    "camera.usb3vision.buffers": "frames that are late wait in the session's queue",
    "camera.usb3vision.control_retries": "a command without reply is repeated three times",
    "camera.v4l2.queued_frames": "64 frames are kept for a reader that is late",
    "controller.faults.seed": "the simulated line has the same faults each time",
}
"""Keys that configurations had, by their dotted names, and why nobody needs to set them."""


def _without_gone_keys(tree: Tree) -> Tree:
    return reduce(_without, GONE, tree)


def _drag_by_name(tree: Tree) -> Tree:
    """A drag was fitted or not; that none was is no statement about the air, and today's default holds."""
    fit = tree.get("fit")
    if not isinstance(fit, Mapping) or "drag" not in fit:
        return tree
    return {**tree, "fit": {**fit, "drag": "open"}} if fit["drag"] is True else _without(tree, "fit.drag")


CONFIGURATION_STEPS: Final[Sequence[Step]] = (_without_gone_keys, _drag_by_name)
"""The first makes schema 2 from schema 1, and so on."""
SCHEMA: Final = 1 + len(CONFIGURATION_STEPS)


def migrated(
    tree: Tree, what: str, steps: Sequence[Step] = CONFIGURATION_STEPS
) -> tuple[dict[str, Any], str]:
    """Today's tables of `what`, and one line that says which keys went or came; empty where none did.

    The tables no longer hold the number. Raises ConfigurationError, one line, for one of a later version.
    """
    schema, today = tree.get(SCHEMA_KEY, 1), 1 + len(steps)
    if not isinstance(schema, int) or isinstance(schema, bool) or schema < 1:
        raise ConfigurationError(f"{what}: schema {schema!r} should be a whole number, at most {today}")
    if schema > today:
        raise ConfigurationError(
            f"{what}: schema {schema} was written by a later version; this one reads up to {today}"
        )
    now = reduce(lambda before, step: step(before), steps[schema - 1 :], tree)
    found = {key: value for key, value in now.items() if key != SCHEMA_KEY}
    keys, keys_now = ({*_keys(each)} - {SCHEMA_KEY} for each in (tree, now))
    changes = [
        f"{word} {', '.join(sorted(other))}"
        for word, other in (("without", keys - keys_now), ("with", keys_now - keys))
        if other
    ]
    return found, f"{what} is of schema {schema}, read as {today}: {'; '.join(changes)}" if changes else ""


def _without(tree: Tree, key: str) -> Tree:
    first, _, rest = key.partition(".")
    below = tree.get(first)
    if rest:
        return {**tree, first: _without(below, rest)} if isinstance(below, Mapping) else tree
    return {name: value for name, value in tree.items() if name != first}


def _keys(tree: Tree, place: str = "") -> Iterator[str]:
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from _keys(value, f"{place}{name}.")
        else:
            yield f"{place}{name}"
