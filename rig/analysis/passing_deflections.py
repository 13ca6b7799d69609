"""Deflections of a run as a stream of blocks, and their correction for beam motion and for fixed light."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.record.reader import RecordReader
from acquisition.record.topics import IMAGE, REFERENCE
from processing.arrays import Ints
from processing.deflections import Deflections, DeflectionUnit
from processing.errors import DataError
from processing.estimate import Estimate
from processing.reference_gain import gain_while_swinging
from processing.reference_spot import (
    CorrectedPositions,
    ReferenceVerdict,
    common_motion,
    subtract_common_motion,
    uncorrected,
)
from processing.spot import SPOT_DTYPE, FixedLight, Spot, SpotFlag, SpotTracker, fixed_light
from rig.instrument import NO_STRAY_LIGHT, optics_of, sensor_model
from rig.settings import Configuration
from rig.terminal import Verdict, percent, with_uncertainty

_MAX_FRAMES_IN_MEMORY = 300_000
"""Most frames whose deflections stay in memory: some twenty megabytes, fifty minutes at 100 frames/s."""


class PassingDeflections:
    """The deflections of a run, in order, some thousand frames at a time.

    Of a long run only the coordinates of the frames that have passed stay in memory, 16 bytes a frame: a
    day's deflections with their times and uncertainties would be several hundred megabytes. A short run stays
    whole, and is not read again for a second pass.

    Parameters
    ----------
    blocks
        Consecutive frames; an iterable that can be iterated again, for further passes of a long run.
    unit
        Unit of every block.

    Attributes
    ----------
    frames, lost_spots
        Number of frames in the first pass, and of those without a spot.
    first_ns, last_ns
        Times of the first and of the last of these frames; 0 where there are none.
    """

    def __init__(self, blocks: Iterable[Deflections], unit: DeflectionUnit) -> None:
        self.unit = unit
        self.frames = 0
        self.lost_spots = 0
        self.first_ns = 0
        self.last_ns = 0
        self._source = blocks
        self._blocks = iter(blocks)
        self._passed = False
        self._kept: list[Deflections] | None = []
        self._x: list[NDArray[np.float64]] = []
        self._y: list[NDArray[np.float64]] = []

    def __iter__(self) -> Iterator[Deflections]:
        """The blocks; the first pass also counts their frames."""
        if self._passed:
            yield from filter(len, self._source if self._kept is None else self._kept)
            return
        for block in self._blocks:
            if not len(block):
                continue
            if not self.frames:
                self.first_ns = int(block.times_ns[0])
            self.last_ns = int(block.times_ns[-1])
            self.frames += len(block)
            self.lost_spots += len(block) - int(np.count_nonzero(block.found))
            self._x.append(block.x[np.isfinite(block.x)])
            self._y.append(block.y[np.isfinite(block.y)])
            if self.frames > _MAX_FRAMES_IN_MEMORY:
                self._kept = None
            if self._kept is not None:
                self._kept.append(block)
            yield block
        self._passed = True

    def fast_ratio(self) -> float:
        """Fast over slow motion (r.m.s. about the median, NaN left out) of all frames; 0 without slow motion.

        The first pass is made if it was not. The coordinates are then discarded: call it once.
        """
        if not self._passed:
            for _ in self:
                pass
        spread_x, spread_y = _spread(self._x), _spread(self._y)
        return spread_x / spread_y if spread_y > 0 else 0.0


def _spread(blocks: list[NDArray[np.float64]]) -> float:
    """Root mean square about the median; `blocks` is emptied."""
    values = np.concatenate([np.empty(0), *blocks])
    blocks.clear()
    if not len(values):
        return 0.0
    values -= np.median(values)
    return float(np.sqrt(np.mean(np.square(values, out=values))))


_MIN_GAIN_U = 4.0
"""Standard uncertainties by which a fitted gain has to differ from zero."""
_PLACES = ("x_px", "y_px", "u_x_px", "u_y_px")
_FIELDS = ("sequence", "flags", *_PLACES)


@dataclass(frozen=True)
class DeflectionCorrection:
    """Correction of a record's deflections.

    `change` corrects those of any of the record's frames. `used` is whether it makes them better, and is
    therefore applied, `note` says so in one line, `verdict` judges the record's condition.
    """

    change: Callable[[Deflections], Deflections]
    used: bool
    note: str = ""
    verdict: Verdict | None = None


def without_beam_motion(reader: RecordReader, config: Configuration) -> DeflectionCorrection | None:
    """The correction for the motion of the beam, by the record's reference spot.

    None without a reference spot, or where it was hardly ever found. It is used where it makes any axis
    quieter.
    """
    if config.reference is None or REFERENCE.topic not in reader.counts:
        return None
    reference, spots, gain = reader.table(REFERENCE.topic), reader.spots(), config.reference.gain
    _, ours, theirs = np.intersect1d(
        spots["sequence"], reference["sequence"], assume_unique=True, return_indices=True
    )
    # no frames are known to be at rest, by which a stated gain could be checked
    quiet = np.zeros(len(spots), dtype=np.bool_)
    found, moved = dict[str, CorrectedPositions](), spots[list(_FIELDS)].copy()
    for name in ("x_px", "y_px"):
        place, u = np.full(len(spots), np.nan), np.full(len(spots), np.nan)
        place[ours], u[ours] = reference[name][theirs], reference[f"u_{name}"][theirs]
        try:
            common = common_motion(spots["time_ns"], place, u)
        except DataError:
            return None
        of_spot = spots[name], spots[f"u_{name}"]
        stated = None if gain is None else Estimate(gain, config.reference.u_gain)
        if stated is None:
            with suppress(DataError):
                stated = gain_while_swinging(spots["time_ns"], *of_spot, place, u)
        if stated is None or not stated.value > _MIN_GAIN_U * stated.standard_uncertainty:
            unknown = stated or Estimate(np.nan, np.inf)
            less = uncorrected(*of_spot, unknown, ReferenceVerdict.UNKNOWN_GAIN)
        else:
            less = subtract_common_motion(*of_spot, common, stated, quiet)
        found[name] = less
        moved[name], moved[f"u_{name}"] = less.position_px, less.u_px
    used = any(one.verdict is ReferenceVerdict.USED for one in found.values())
    return DeflectionCorrection(
        deflection_change(config, spots, moved), used, _reference_note(found, is_stated=gain is not None)
    )


def _reference_note(found: Mapping[str, CorrectedPositions], *, is_stated: bool) -> str:
    """Verdict on the reference spot, in one line; the gain where it `is_stated` by no configuration."""
    lost = int(np.count_nonzero(next(iter(found.values())).fallen_back))
    texts = []
    for name, one in found.items():
        own = not is_stated and np.isfinite(one.gain.value)
        by_run = f" with a gain of {with_uncertainty(*one.gain)} from the run itself" if own else ""
        texts.append(f"{name[0]} {one.verdict}{by_run}")
    fallen = f"; {lost} frames without it are unchanged" if lost else ""
    return f"reference spot: {', '.join(texts)}{fallen}"


def deflection_change(
    config: Configuration, spots: np.ndarray, moved: np.ndarray
) -> Callable[[Deflections], Deflections]:
    """Function that changes deflections, and their variances, as if the record's spots were at `moved`."""
    deflector = optics_of(config, full_scale_dn=1.0).deflector((1, 1))
    before, after = (deflector(spots["time_ns"], _spots(table)) for table in (spots, moved))
    times_ns = spots["time_ns"]
    by = np.nan_to_num(np.stack([after.x - before.x, after.y - before.y]))
    variance = np.nan_to_num(np.stack([after.u_x**2 - before.u_x**2, after.u_y**2 - before.u_y**2]), nan=0.0)

    def changed(deflections: Deflections) -> Deflections:
        behind = np.clip(np.searchsorted(times_ns, deflections.times_ns), 1, len(times_ns) - 1)
        nearer = deflections.times_ns - times_ns[behind - 1] < times_ns[behind] - deflections.times_ns
        rows = np.where(nearer, behind - 1, behind)
        (x, y), (of_x, of_y) = by[:, rows], variance[:, rows]
        return replace(
            deflections,
            x=deflections.x + x,
            y=deflections.y + y,
            u_x=np.sqrt(deflections.u_x**2 + of_x),
            u_y=np.sqrt(deflections.u_y**2 + of_y),
        )

    return changed


class ChangedDeflections:
    """Deflections with a change of each block, at every iteration."""

    def __init__(self, blocks: Iterable[Deflections], change: Callable[[Deflections], Deflections]) -> None:
        self._blocks, self._change = blocks, change

    def __iter__(self) -> Iterator[Deflections]:
        return map(self._change, self._blocks)


_LIGHT_PICTURES = 48
"""Whole frames of a record in which fixed light is sought."""
_STEPS_PER_DN = 16
"""Steps a DN in which the light is subtracted from a picture."""
_MAX_LOST_SHARE = 0.1
"""Largest share of the affected frames that may have no spot without the light."""
_LARGEST_FULL_SCALE_DN = 4095
"""Largest full scale in DN at which `_STEPS_PER_DN` steps a DN fit into 16 bits."""


def without_fixed_light(reader: RecordReader, config: Configuration) -> DeflectionCorrection | None:
    """The correction for fixed light in the whole frames of a record; None where there is none.

    The affected frames are tracked without it, which needs the pixels around the spot: without them it is
    not used, and the condition is not met, else there is a warning.
    """
    every = max(1, reader.counts.get(IMAGE.topic, 0) // _LIGHT_PICTURES)
    images = {one.sequence: one.image for one in reader.images(every=every)}
    pictures = []
    for block in reader.spot_blocks(fields=("sequence", *Spot._fields)) if images else ():
        for row in np.flatnonzero(np.isin(block["sequence"], list(images))):
            spot = Spot(*(block[name][row].item() for name in Spot._fields))
            pictures.append((images[int(block["sequence"][row])], spot))
    light = fixed_light(pictures)
    if light is None:
        return None
    spots = np.concatenate(list(reader.spot_blocks(fields=_FIELDS)))
    pulled = light.affects(spots["x_px"], spots["y_px"])
    # a learned profile depends on all frames
    again = pulled | bool(np.any(spots["flags"] & SpotFlag.LEARNED))
    found = _tracked_again(reader, config, light, spots["sequence"][again])
    moved, rows = spots.copy(), np.flatnonzero(pulled)
    kept = [found.get(number) for number in spots["sequence"][rows].tolist()]
    for name in _PLACES:
        moved[name][rows] = [np.nan if spot is None else getattr(spot, name) for spot in kept]
    lost = np.flatnonzero(pulled & ~np.isfinite(moved["x_px"]))
    used = len(lost) < _MAX_LOST_SHARE * max(len(rows), 1)
    # a lost spot stays in its place with an uncertainty of 1 px, so that it has hardly any weight
    for name in _PLACES:
        moved[name][lost] = 1.0 if name.startswith("u_") else spots[name][lost]
    done = "taken off" if used else "not taken off, as the record has no pixels of the spot"
    measured = f"pulls {len(rows)} of {len(spots)} ({percent(len(rows) / len(spots))}), {done}"
    verdict = Verdict("fixed light", used, light.text, NO_STRAY_LIGHT, measured, "none")
    return DeflectionCorrection(deflection_change(config, spots, moved), used, verdict=verdict)


def _tracked_again(
    reader: RecordReader, config: Configuration, light: FixedLight, sequences: Ints
) -> dict[int, Spot]:
    """The spots of some frames, tracked again in their pixels less the light; without those lost."""
    fine = _STEPS_PER_DN if reader.full_scale_dn <= _LARGEST_FULL_SCALE_DN else 1
    stated = sensor_model(config, reader.full_scale_dn)
    full, less = fine * int(stated.full_scale_dn), np.rint(fine * light.subtracted_dn).astype(np.int64)
    tracker = SpotTracker(
        replace(
            stated,
            gain_e_per_dn=stated.gain_e_per_dn / fine,
            full_scale_dn=full,
            pedestal_dn=stated.pedestal_dn * fine,
        )
    )
    asked, found = set(sequences.tolist()), {}
    for window in reader.windows():
        if window.sequence not in asked:
            continue
        (x0, y0), (ny, nx) = window.origin_px, window.image.shape
        pixels = fine * window.image.astype(np.int64)
        left = np.where(pixels >= full, full, np.maximum(pixels - less[y0 : y0 + ny, x0 : x0 + nx], 0))
        spot = tracker.track(left.astype(np.uint16), window.origin_px, less.shape)
        if not spot.flags & SpotFlag.LOST:
            found[window.sequence] = spot
    return found


def _spots(table: np.ndarray) -> list[Spot]:
    whole = np.zeros(len(table), dtype=SPOT_DTYPE)
    for name in _PLACES:
        whole[name] = table[name]
    return [Spot(*row) for row in whole.tolist()]
