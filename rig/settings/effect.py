"""Which of the changed keys have an effect: those that are read while the work is done."""

import copy
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from typing import Any, cast

from pydantic import BaseModel

from processing.errors import ConfigurationError
from rig.settings.configuration import Configuration


class Watched:
    """A configuration that notes which of its changed keys are read; to copy it reads none of them.

    `config` compares equal to the one that is watched. `remedy` says what to do about a key without effect.
    """

    def __init__(self, config: Configuration, overrides: Iterable[str], remedy: str) -> None:
        self._keys = [override.partition("=")[0].strip() for override in overrides]
        self._read: set[str] = set()
        self._remedy = remedy
        watched: Any = config
        for key in self._keys:
            watched = _with_watch(watched, key.split("."), partial(self._read.add, key))
        self.config = cast(Configuration, watched)
        self._read.clear()

    @property
    def unread(self) -> list[str]:
        """Changed keys that nothing has read so far."""
        return [key for key in self._keys if key not in self._read]

    def refuse_read(self) -> None:
        """Raise ConfigurationError if a changed key was read by what cannot be done again."""
        self._refuse(self._read)

    def refuse_unread(self, others: Iterable["Watched"] = ()) -> None:
        """Raise ConfigurationError with a line for each changed key that nothing has read, here or there."""
        self._refuse(set(self.unread).intersection(*(other.unread for other in others)))

    def _refuse(self, keys: Collection[str]) -> None:
        if keys:
            lines = (f"--set {key}: has no effect here; {self._remedy}" for key in self._keys if key in keys)
            raise ConfigurationError("\n".join(lines))


def _with_watch(holder: Any, place: Sequence[str], note: Callable[[], None]) -> Any:
    """A copy in which reading what stands at `place`, or anything of a section that does, is noted."""
    first, *below = place
    value = holder[first] if isinstance(holder, Mapping) else getattr(holder, first)
    if below:
        return _with(holder, first, _with_watch(value, below, note))
    if isinstance(value, Mapping):
        return _with(
            holder, first, {name: _watching(each, _names(each), note) for name, each in value.items()}
        )
    if names := _names(value):
        return _with(holder, first, _watching(value, names, note))
    return _watching(holder, {first}, note)


def _names(value: Any) -> set[str]:
    """The keys of a section; none of a plain value."""
    if isinstance(value, BaseModel):
        return set(type(value).model_fields)
    return {field.name for field in fields(value)} if is_dataclass(value) else set()


def _with(holder: Any, name: str, value: Any) -> Any:
    if isinstance(holder, Mapping):
        return {**holder, name: value}
    changed = copy.copy(holder)
    # both are frozen
    object.__setattr__(changed, name, value)
    return changed


def _watching(section: Any, names: set[str], note: Callable[[], None]) -> Any:
    if not _names(section):
        return section
    kind: Any = type(section)
    shown_kind = section.__class__

    def reading(self: Any, name: str) -> Any:
        if name in names:
            note()
        return kind.__getattribute__(self, name)

    # equality of models and dataclasses asks for the same `__class__`
    namespace = {
        "__module__": kind.__module__,
        "__slots__": (),
        "__getattribute__": reading,
        "__class__": property(lambda _: shown_kind),
    }
    watching = type(kind)(kind.__name__, (kind,), namespace)
    found = copy.copy(section)
    vars(object)["__class__"].__set__(found, watching)
    return found
