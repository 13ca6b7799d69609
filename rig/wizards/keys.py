"""Questions about keys of a file: units follow from their names, ranges and faults from the file's model."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from processing.errors import ConfigurationError
from processing.units import unit_of_name
from rig.settings import keys_with_faults, number, quantity
from rig.wizards.question import Question

Keys = Mapping[str, Any]
"""Values by dotted key."""


@dataclass(frozen=True)
class KeysOf:
    """Reads answers that are keys of a file with this model; None: of the configuration."""

    root: type[BaseModel] | None = None

    def checked(self, keys: Keys, *, whole: str = "") -> dict[str, Any]:
        """The keys, if the model takes them; raises ConfigurationError with its own line if not.

        `whole` names a section of which all is stated, so that what holds between its keys is checked, too.
        """
        if lines := keys_with_faults(keys, whole, self.root):
            raise ConfigurationError("; ".join(lines))
        return dict(keys)

    def measured(
        self, name: str, what: str, key: str, example: str, *, do: str = "", suggested: str | None = None
    ) -> Question:
        """Asks for a number and its standard uncertainty, which has a key of its own.

        With `suggested` "", Enter leaves it out, as `example` says.
        """
        unit = unit_of_name(key.rpartition(".")[2])

        def read(text: str) -> dict[str, Any]:
            if not text:
                return {}
            value, u = quantity(text, unit)
            section, dot, last = key.rpartition(".")
            return self.checked({key: value} | ({} if u is None else {f"{section}{dot}u_{last}": u}))

        text = f"{what}{f', in {unit}' if unit else ''} ({example}):"
        return Question(name, text, read, do=do, suggested=suggested, says_enter=suggested == "")

    def alone(self, key: str, beside: Keys | None = None, whole: str = "") -> Callable[[str], dict[str, Any]]:
        """Reads a number without uncertainty, together with other keys."""
        unit = unit_of_name(key.rpartition(".")[2])
        return lambda text: self.checked({**(beside or {}), key: number(unit)(text)}, whole=whole)

    def text(self, key: str) -> Callable[[str], dict[str, Any]]:
        """Reads any text; nothing for an empty answer."""
        return lambda text: self.checked({key: text}) if text else {}
