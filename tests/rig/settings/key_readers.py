"""Records which keys of the configuration are read while parts of the program run."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pydantic
from pydantic import BaseModel

from rig.settings.sections import BalanceSettings

Key = tuple[type, str]
_PYDANTIC = str(Path(pydantic.__file__).parent)
_DEPTH = 4


def _called_by_pydantic(depth: int) -> bool:
    """Whether the read happens while a model is validated or copied (or in a method that this calls)."""
    frame = sys._getframe(depth)
    for _ in range(_DEPTH):
        if frame.f_code.co_filename.startswith(_PYDANTIC):
            return True
        if frame.f_back is None:
            return False
        frame = frame.f_back
    return False


@contextmanager
def keys_read() -> Iterator[set[Key]]:
    """The keys that are read meanwhile, in any thread.

    A key that is only validated, copied and written down with the others has no effect; reading it
    for that does not count.
    """
    seen: set[Key] = set()
    plain = BaseModel.__getattribute__

    def reading(self: BaseModel, name: str) -> object:
        model = type(self)
        if name in model.__pydantic_fields__ and (model, name) not in seen and not _called_by_pydantic(2):
            seen.add((model, name))
        return plain(self, name)

    def reading_balance(self: BalanceSettings, name: str) -> object:
        if name in BalanceSettings.__dataclass_fields__ and not _called_by_pydantic(2):
            seen.add((BalanceSettings, name))
        return object.__getattribute__(self, name)

    BaseModel.__getattribute__ = reading  # type: ignore[method-assign]
    # the one section with keys of its own that is a plain dataclass
    BalanceSettings.__getattribute__ = reading_balance  # type: ignore[method-assign]
    try:
        yield seen
    finally:
        BaseModel.__getattribute__ = plain  # type: ignore[method-assign]
        del BalanceSettings.__getattribute__


def is_read(key: Key, seen: set[Key]) -> bool:
    """Whether a key was read, from its own model or as an inherited one."""
    model, name = key
    return any(
        name == read and (issubclass(reader, model) or issubclass(model, reader)) for reader, read in seen
    )
