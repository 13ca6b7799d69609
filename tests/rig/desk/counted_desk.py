"""`rig desk` that counts its objects: a line on standard input is answered with how many there are.

`python -m tests.rig.desk.counted_desk CONFIG`. The answer is a line of JSON: objects that the collector
knows, by kind, and of the page's client its elements and the messages that wait or are kept.
"""

import gc
import json
import sys
import threading
from collections import Counter

from nicegui import Client

from rig.cli import main


def count() -> dict[str, int]:
    """What is alive after a collection."""
    gc.collect()
    found = Counter(type(one).__name__ for one in gc.get_objects())
    clients = list(Client.instances.values())
    return {
        **found,
        "all": sum(found.values()),
        "clients": len(clients),
        "elements": sum(len(one.elements) for one in clients),
        "messages": sum(len(one.outbox.messages) + len(one.outbox.message_history) for one in clients),
    }


def answer() -> None:
    """Until standard input is closed."""
    for _ in sys.stdin:
        print(json.dumps(count()), flush=True)


if __name__ == "__main__":
    threading.Thread(target=answer, daemon=True).start()
    sys.argv = ["rig", "desk", sys.argv[1], "--no-browser"]
    main()
