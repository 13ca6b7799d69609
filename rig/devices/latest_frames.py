"""The newest frames of a camera, for a live picture."""

import threading
import time
from collections.abc import Generator

from acquisition.camera import Camera
from acquisition.frame import Frame
from acquisition.frames.guard import Delivered
from acquisition.frames.queue import FrameQueue

_LOOK_S = 0.2
_TIMEOUT_S = 5.0


def watch_latest(
    camera: Camera,
    queue: FrameQueue,
    at_least: int,
    end_s: float,
    interval_s: float = _LOOK_S,
) -> Generator[list[Frame]]:
    """Yield blocks of `at_least` frames, at most one per `interval_s`; the queue drops older frames.

    The camera must be configured and stopped. It runs until the monotonic time `end_s`, but for one block
    at least; until its source ends; or until the caller stops iterating. It is then stopped. Errors of the
    camera, and frames that no camera may deliver, are raised here.
    """
    errors: list[Exception] = []
    delivered = Delivered()

    def acquire() -> None:
        try:
            while (frame := camera.read(_TIMEOUT_S)) is not None:
                if queue.put(delivered.checked(frame)) is None or ended.is_set():
                    break
        except Exception as error:
            errors.append(error)
        finally:
            queue.close()

    ended = threading.Event()
    camera.start()
    thread = threading.Thread(target=acquire, name="camera", daemon=True)
    thread.start()
    try:
        while not queue.drained:
            frames: list[Frame] = []
            while len(frames) < at_least and not queue.drained:
                frames += queue.take(at_least - len(frames), 0.1)
            if frames:
                yield frames
            if time.monotonic() >= end_s:
                break
            time.sleep(interval_s)
        if errors:
            raise errors[0]
    finally:
        ended.set()
        queue.close()
        camera.stop()
        thread.join(_TIMEOUT_S)
