"""Somebody who acts beside the program that is tested."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rig.devices import ORDERS_NAME, NoSession, OrderConnection


@contextmanager
def acting(person: Callable[[], object]) -> Iterator[None]:
    """A context in which somebody acts, whose end is waited for."""
    thread = threading.Thread(target=person)
    thread.start()
    try:
        yield
    finally:
        thread.join()


def at_desk(folder: Path, act: Callable[[OrderConnection], object]) -> None:
    """As a desk: act again and again while the session of a folder answers, until that has ended."""
    heard = False
    while not heard or (folder / ORDERS_NAME).exists():
        with suppress(NoSession), OrderConnection(folder) as line:
            while True:
                heard = True
                act(line)
                time.sleep(0.05)
        time.sleep(0.05)
