"""FFmpeg through PyAV, which is an option: found where a film is opened, and silent."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from processing.errors import DeviceError

if TYPE_CHECKING:
    from av.container import InputContainer


def pyav() -> Any:
    """The module. Raises DeviceError with the remedy where it is not installed."""
    try:
        import av
    except ImportError:
        raise DeviceError(
            "films are read with PyAV, which is not installed; install it (pip install av), or convert the "
            "film to a "
            "folder of images"
        ) from None
    # what is wrong with a film is counted and said by those who read it
    av.logging.set_level(None)
    # what a decoder says twice it means twice
    av.logging.set_skip_repeated(False)
    return av


def opened_film(path: Path) -> "InputContainer":
    """The container. Raises DeviceError for what FFmpeg takes for no film."""
    av = pyav()
    try:
        container: InputContainer = av.open(str(path))
    except (av.FFmpegError, OSError) as error:
        raise DeviceError(
            f"{path}: cannot be read as a video ({error.strerror}); use a folder of images, or a .tif or "
            ".npy stack"
        ) from None
    return container


def ffmpeg_error() -> type[Exception]:
    """What reading a damaged film raises."""
    error: type[Exception] = pyav().FFmpegError
    return error
