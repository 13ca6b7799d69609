"""The configurations that come with the program: in its wheel, or beside it in a copy of the repository."""

from importlib.resources import files
from pathlib import Path

from processing.errors import ConfigurationError


def _folder() -> Path:
    package = Path(str(files("rig")))
    return next(folder for folder in (package / "configs", package.parent / "configs") if folder.is_dir())


def shipped_names() -> list[str]:
    """Names by which `shipped` finds a configuration."""
    return sorted(path.stem for path in _folder().glob("*.toml"))


def shipped(name: str) -> Path:
    """The file of a configuration, ``basement`` for ``basement.toml``.

    Raises ConfigurationError with the names that there are.
    """
    if name not in (names := shipped_names()):
        raise ConfigurationError(
            f"example {name}: there is no such configuration; there are {', '.join(names)}"
        )
    return _folder() / f"{name}.toml"
