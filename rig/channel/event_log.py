"""The events of a session in one order and on one clock: since the record of its present run began."""

import math
from collections.abc import Iterable, Mapping
from typing import Any


def since_record(news: Mapping[str, Any], event: Mapping[str, Any]) -> float:
    """Time of an event since the record of the present run began, negative before; NaN while there is none.

    An event of this run's record has it. What was noted without a time, and what belongs to an earlier run,
    whose own times count from another record, is placed by when it was noted.
    """
    began_s, elapsed_s = _number(news.get("record_began_s")), _number(event["elapsed_s"])
    if event["run"] == news.get("run") and not math.isnan(began_s + elapsed_s):
        return elapsed_s
    return float(event["noted_s"]) - began_s


def _number(told: float | None) -> float:
    """NaN is null on its way to a desk."""
    return math.nan if told is None else float(told)


def newest_first(
    news: Mapping[str, Any], events: Iterable[Mapping[str, Any]]
) -> list[tuple[float, Mapping[str, Any]]]:
    """Events with their times since the record began, the newest first; by number while none has begun."""
    timed = [(since_record(news, event), event) for event in events]
    return sorted(
        timed, key=lambda one: (0.0 if math.isnan(one[0]) else one[0], one[1]["number"]), reverse=True
    )
