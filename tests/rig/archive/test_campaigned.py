"""The order in which a campaign takes the runs of an archive."""

import datetime

from rig.archive.campaigned import in_order

EVENING = datetime.datetime(2024, 2, 28, 23, 0)


def test_runs_are_in_the_order_of_their_beginnings_over_all_sessions() -> None:
    hours = {"a": (0, 26, 48), "b": (12, 30)}
    runs = [
        (folder, f"run-{number}", EVENING + datetime.timedelta(hours=begun))
        for folder, found in hours.items()
        for number, begun in enumerate(found, start=1)
    ]
    assert [runs[place][:2] for place in in_order(runs)] == [
        ("a", "run-1"), ("b", "run-1"), ("a", "run-2"), ("b", "run-2"), ("a", "run-3"),
    ]  # fmt: skip


def test_a_clock_that_was_set_back_does_not_turn_a_session_round() -> None:
    """After run 9 the computer found the time of day: an hour less than it had believed."""
    believed = [EVENING + datetime.timedelta(minutes=20 * number) for number in range(12)]
    an_hour = datetime.timedelta(hours=1)
    true = [time if number < 9 else time - an_hour for number, time in enumerate(believed)]
    runs = [("night", f"run-{number}", began) for number, began in enumerate(true, start=1)]
    places = in_order([*reversed(runs), ("other", "run-1", None)])
    assert places == [*range(11, -1, -1), 12]
