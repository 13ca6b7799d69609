"""One remark as it lies in its file."""

from pathlib import Path

from pydantic import AwareDatetime, BaseModel, ValidationError

from processing.errors import RecordError


class Remark(BaseModel, frozen=True):
    """One command: tags added to and removed from runs (by the SHA-256 of their records), or a note."""

    utc: AwareDatetime
    user: str = ""
    computer: str = ""
    runs: tuple[str, ...]
    add: tuple[str, ...] = ()
    remove: tuple[str, ...] = ()
    note: str = ""


def read_remark(path: Path) -> Remark:
    """A remark from its file. Raises RecordError where it cannot be understood."""
    try:
        return Remark.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise RecordError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None
