"""Which runs reach a goal in the least rig time: chosen one after the other, then exchanged, then ordered."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, log

import numpy as np

from processing.arrays import Floats
from processing.campaign.outlook import CandidateRun, Outlook

_ENDLESS = 1e4
"""Runs of every kind after which nothing more is to be had."""
_SWEEPS = 4
_CLOSE = 0.999


@dataclass(frozen=True, slots=True)
class ChosenRun:
    """A run of a plan, and the worst expected uncertainty over its limit before it and after it."""

    candidate: CandidateRun
    before: float
    after: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """Runs in the order in which they should be made.

    Attributes
    ----------
    runs
        Empty where the goal is reached already, or cannot be.
    now, expected
        Worst expected uncertainty over its limit: at present, and after all runs.
    floor
        What is left of it after as many runs as one likes: above 1 the goal cannot be reached by these.
    gains
        By label, how much each candidate as the first run would lower the logarithm of `now` in an hour.
    """

    runs: tuple[ChosenRun, ...]
    now: float
    expected: float
    floor: float
    gains: tuple[tuple[str, float], ...] = ()

    @property
    def reached(self) -> bool:
        return self.expected < 1

    @property
    def rig_time_s(self) -> float:
        return sum(one.candidate.rig_time_s for one in self.runs)


def choose_runs(ahead: Outlook, *, longest_s: float = inf, most: int = 200, seed: int = 1) -> Choice:
    """The set of runs that reaches all goals in the least rig time, randomised in blocks by a seed.

    Where they cannot be reached within `longest_s` or by `most` runs, the runs that come nearest; where no
    number of runs reaches them, none.
    """
    now = ahead.ratio(ahead.before)
    floor = ahead.ratio(ahead.before + _ENDLESS * sum(_once(ahead)))
    ranked = _ranked(ahead)
    if now < 1 or floor >= 1:
        return Choice(runs=(), now=now, expected=now, floor=floor, gains=ranked)
    starts = [_greedily(ahead, [], longest_s, most)]
    starts += [_alone(ahead, which, longest_s, most) for which in range(len(ahead.candidates))]
    good = [one for one in starts if _ratio(ahead, one) < 1]
    if good:
        best = _exchanged(ahead, min(good, key=lambda one: _time_s(ahead, one)))
    else:
        best = min(starts, key=lambda one: _ratio(ahead, one))
    order = _in_blocks(ahead.candidates, best, np.random.default_rng(seed))
    # where it counts when a run is made, another order may need more of them
    if good:
        order = _greedily(ahead, order, longest_s, most)
    return _in_order(ahead, order, Choice(runs=(), now=now, expected=now, floor=floor, gains=ranked))


def choose_next(ahead: Outlook, *, longest_s: float = inf, most: int = 200, seed: int = 1) -> Choice:
    """The same for one who learns after every run, and ends as soon as that may be: the first run counts.

    How runs scatter will be known better by then. So it is not the time that counts after which the
    uncertainty is reached on average over the scatters, but the average of the times after which it is
    reached for each. Precise runs, of which few are enough where they scatter little, gain by that.
    """
    planned = choose_runs(ahead, longest_s=longest_s, most=most, seed=seed)
    if ahead.ordered or not planned.reached or not planned.runs:
        return planned
    places = {id(one): which for which, one in enumerate(ahead.candidates)}
    best = [places[id(one.candidate)] for one in planned.runs]
    least_s = _mean_time_s(ahead, best, most)
    for which in range(len(ahead.candidates)):
        order = _alone(ahead, which, longest_s, most)
        if not order or _ratio(ahead, order) >= 1:
            continue
        mean_s = _mean_time_s(ahead, order, most)
        if mean_s < _CLOSE * least_s:
            best, least_s = order, mean_s
    return _in_order(ahead, best, planned)


def _mean_time_s(ahead: Outlook, order: Sequence[int], most: int) -> float:
    """Time until the goals are reached by these runs in turns, for each draw of the scatters; its mean. What
    so many runs do not reach counts as twice their time."""
    whole, elapsed_s = ahead.before, 0.0
    reached_s = np.full(len(whole), np.nan)
    for place in range(most + 1):
        reached_s[ahead.reached(whole) & np.isnan(reached_s)] = elapsed_s
        if not np.any(np.isnan(reached_s)):
            break
        which = order[place % len(order)]
        whole = whole + ahead.adds(which, elapsed_s, place)
        elapsed_s += ahead.candidates[which].rig_time_s
    return float(np.mean(np.where(np.isnan(reached_s), 2 * elapsed_s, reached_s)))


def _in_order(ahead: Outlook, order: Sequence[int], known: Choice) -> Choice:
    """The choice of these runs, with what is left after each."""
    now, floor, ranked = known.now, known.floor, known.gains
    runs, before, ratio = [], ahead.before, now
    for place, which in enumerate(order):
        before = before + ahead.adds(which, _time_s(ahead, order[:place]), place)
        after = ahead.ratio(before)
        runs.append(ChosenRun(ahead.candidates[which], ratio, after))
        ratio = after
    return Choice(runs=tuple(runs), now=now, expected=ratio, floor=floor, gains=ranked)


def _once(ahead: Outlook) -> list[Floats]:
    return [ahead.adds(which, 0.0, place) for which in range(len(ahead.candidates)) for place in (0, 1)]


def _ranked(ahead: Outlook) -> tuple[tuple[str, float], ...]:
    """Candidates by what each would gain of the goal's logarithm in an hour."""
    begin = log(ahead.merit(ahead.before))
    gains = [
        (
            one.label,
            3600 * (begin - log(ahead.merit(ahead.before + ahead.adds(which, 0.0, 0)))) / one.rig_time_s,
        )
        for which, one in enumerate(ahead.candidates)
    ]
    return tuple(sorted(gains, key=lambda one: -one[1]))


def _time_s(ahead: Outlook, order: Sequence[int]) -> float:
    return sum(ahead.candidates[which].rig_time_s for which in order)


def _after(ahead: Outlook, order: Sequence[int]) -> Floats:
    whole, elapsed_s = ahead.before, 0.0
    for place, which in enumerate(order):
        whole = whole + ahead.adds(which, elapsed_s, place)
        elapsed_s += ahead.candidates[which].rig_time_s
    return whole


def _ratio(ahead: Outlook, order: Sequence[int]) -> float:
    return ahead.ratio(_after(ahead, order))


def _greedily(ahead: Outlook, begun: Sequence[int], longest_s: float, most: int) -> list[int]:
    """Runs added one after the other, each the one that gains most for its time."""
    order, whole, elapsed_s = list(begun), _after(ahead, begun), _time_s(ahead, begun)
    while ahead.ratio(whole) >= 1 and len(order) < most:
        merit, best, gain = ahead.merit(whole), -1, 0.0
        for which, one in enumerate(ahead.candidates):
            if elapsed_s + one.rig_time_s <= longest_s:
                after = ahead.merit(whole + ahead.adds(which, elapsed_s, len(order)))
                found = (log(merit) - log(after)) / one.rig_time_s
                best, gain = (which, found) if found > gain else (best, gain)
        if best < 0:
            break
        whole = whole + ahead.adds(best, elapsed_s, len(order))
        elapsed_s += ahead.candidates[best].rig_time_s
        order.append(best)
    return order


def _alone(ahead: Outlook, which: int, longest_s: float, most: int) -> list[int]:
    """Runs of one kind, of all contacts in turns."""
    kind = ahead.candidates[which].label
    turns = [place for place, one in enumerate(ahead.candidates) if one.label == kind]
    if turns[0] != which:
        return []
    order: list[int] = []
    whole, elapsed_s = ahead.before, 0.0
    while ahead.ratio(whole) >= 1 and len(order) < most:
        one = turns[len(order) % len(turns)]
        if elapsed_s + ahead.candidates[one].rig_time_s > longest_s:
            break
        whole = whole + ahead.adds(one, elapsed_s, len(order))
        elapsed_s += ahead.candidates[one].rig_time_s
        order.append(one)
    return order


def _exchanged(ahead: Outlook, begun: list[int]) -> list[int]:
    """Runs left out, or exchanged for shorter ones, as long as the goal is reached."""
    order = list(begun)
    for _ in range(_SWEEPS):
        whole, elapsed_s = _after(ahead, order), _time_s(ahead, order)
        best, least_s = order, elapsed_s
        seen: set[int] = set()
        for place, which in enumerate(order):
            if which in seen and not ahead.ordered:
                continue
            seen.add(which)
            began_s = _time_s(ahead, order[:place]) if ahead.ordered else 0.0
            less = whole - ahead.adds(which, began_s, place)
            for other in (-1, *range(len(ahead.candidates))):
                after_s = elapsed_s - ahead.candidates[which].rig_time_s
                after_s += ahead.candidates[other].rig_time_s if other >= 0 else 0.0
                if after_s >= least_s:
                    continue
                tried = [*order[:place], *([other] if other >= 0 else []), *order[place + 1 :]]
                # later runs move to other times, and places: looked at only where it promises something
                promised = less if other < 0 else less + ahead.adds(other, began_s, place)
                if ahead.ratio(promised) < _CLOSE and _ratio(ahead, tried) < _CLOSE:
                    best, least_s = tried, after_s
        if best is order:
            break
        order = best
    return order


def _in_blocks(
    candidates: Sequence[CandidateRun], chosen: Sequence[int], rng: np.random.Generator
) -> list[int]:
    """As many blocks as there are runs of the most frequent kind; other kinds are spread over them evenly, by
    chance. In a block the runs of a contact are together, for changing it takes a person.
    """
    counts = {which: chosen.count(which) for which in sorted(set(chosen))}
    blocks: list[list[int]] = [[] for _ in range(max(counts.values(), default=0))]
    for which, count in counts.items():
        for place in (
            ((np.arange(count) + rng.uniform(size=count)) * len(blocks) / count).astype(int).tolist()
        ):
            blocks[place].append(which)
    order: list[int] = []
    for block in blocks:
        contacts = list(dict.fromkeys(candidates[which].contact for which in block))
        for contact in rng.permutation(len(contacts)).tolist():
            own = [which for which in block if candidates[which].contact == contacts[contact]]
            order += [own[place] for place in rng.permutation(len(own)).tolist()]
    return order
