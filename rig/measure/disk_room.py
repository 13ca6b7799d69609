"""How much room the disk of a session's folder has."""

import shutil
from pathlib import Path

from processing.errors import RecordError


def free_bytes(folder: Path) -> int:
    """Raises RecordError where the folder has gone while the session runs."""
    try:
        return shutil.disk_usage(folder).free
    except OSError as error:
        raise RecordError(
            f"{folder}: {error.strerror or error}; was it removed or renamed while its session ran? nothing "
            "was recorded: name a folder that stays"
        ) from None
