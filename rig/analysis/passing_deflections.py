"""Deflections of a run as a stream of blocks, and their correction for beam motion and for fixed light."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from acquisition.record.reader import RecordReader
from acquisition.record.topics import IMAGE, REFERENCE, WINDOW
from processing.arrays import Floats, Ints
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

    `blocks` are consecutive frames in `unit`; for further passes of a long run they are iterated again. A
    short run stays in memory. Of a long one only the coordinates stay, 16 bytes a frame: a day's deflections
    with their times and uncertainties would be several hundred megabytes. `frames` is the number of frames in
    the first pass, `lost_spots` that of those without a spot, `first_ns` and `last_ns` are the times of the
    first and of the last; 0 where there are none.
    """

    def __init__(self, blocks: Iterable[Deflections], unit: DeflectionUnit) -> None:
        self.unit = unit
        self.frames = self.lost_spots = self.first_ns = self.last_ns = 0
        self._source = blocks
        self._first_pass = filter(len, blocks)
        self._has_passed = False
        self._in_memory: list[Deflections] | None = []
        self._x: list[Floats] = []
        self._y: list[Floats] = []

    def __iter__(self) -> Iterator[Deflections]:
        """The blocks; the first pass also counts their frames."""
        if self._has_passed:
            yield from filter(len, self._source if self._in_memory is None else self._in_memory)
            return
        for block in self._first_pass:
            if not self.frames:
                self.first_ns = int(block.times_ns[0])
            self.last_ns = int(block.times_ns[-1])
            self.frames += len(block)
            self.lost_spots += len(block) - int(np.count_nonzero(block.found))
            self._x.append(block.x[np.isfinite(block.x)])
            self._y.append(block.y[np.isfinite(block.y)])
            if self.frames > _MAX_FRAMES_IN_MEMORY:
                self._in_memory = None
            if self._in_memory is not None:
                self._in_memory.append(block)
            yield block
        self._has_passed = True

    def pass_first(self) -> None:
        """Make the first pass, if it was not made."""
        if not self._has_passed:
            for _ in self:
                pass

    def fast_ratio(self) -> float:
        """Fast over slow motion (r.m.s. about the median, NaN left out) of all frames; 0 without slow motion.

        The first pass is made if it was not. The coordinates are then discarded: call it once.
        """
        self.pass_first()
        spread_x, spread_y = _spread(self._x), _spread(self._y)
        return spread_x / spread_y if spread_y > 0 else 0.0


def _spread(blocks: list[Floats]) -> float:
    """Root mean square about the median; `blocks` is emptied."""
    values = np.concatenate([np.empty(0), *blocks])
    blocks.clear()
    if not len(values):
        return 0.0
    values -= np.median(values)
    return float(np.sqrt(np.mean(np.square(values, out=values))))


_MIN_GAIN_U = 4.0
"""Standard uncertainties by which a fitted gain has to differ from zero."""
_POSITION_FIELDS = ("x_px", "y_px", "u_x_px", "u_y_px")
_FIELDS = ("sequence", "flags", *_POSITION_FIELDS)


@dataclass(frozen=True)
class DeflectionCorrection:
    """Correction of a record's deflections."""

    correct: Callable[[Deflections], Deflections]
    """Function that corrects the deflections of any of the record's frames."""
    used: bool
    """Whether the correction makes the deflections better, and is therefore applied."""
    note: str = ""
    """Text on whether the correction is used, in one line."""
    verdict: Verdict | None = None
    """Verdict on the condition of the run that the correction concerns."""


def without_beam_motion(reader: RecordReader, config: Configuration) -> DeflectionCorrection | None:
    """The correction for the motion of the beam, by the record's reference spot.

    It is None without a reference spot, or where that was hardly ever found. It is used where it makes any
    axis quieter.
    """
    if config.reference is None or REFERENCE.topic not in reader.counts:
        return None
    reference, spots, stated_gain = reader.table(REFERENCE.topic), reader.spots(), config.reference.gain
    _, spot_rows, reference_rows = np.intersect1d(
        spots["sequence"], reference["sequence"], assume_unique=True, return_indices=True
    )
    # no frames are known to be at rest, by which a stated gain could be checked
    quiet = np.zeros(len(spots), dtype=np.bool_)
    by_axis, corrected = dict[str, CorrectedPositions](), spots[list(_FIELDS)].copy()
    for name in ("x_px", "y_px"):
        position, u = np.full(len(spots), np.nan), np.full(len(spots), np.nan)
        position[spot_rows] = reference[name][reference_rows]
        u[spot_rows] = reference[f"u_{name}"][reference_rows]
        try:
            common = common_motion(spots["time_ns"], position, u)
        except DataError:
            return None
        spot = spots[name], spots[f"u_{name}"]
        gain = None if stated_gain is None else Estimate(stated_gain, config.reference.u_gain)
        if gain is None:
            with suppress(DataError):
                gain = gain_while_swinging(spots["time_ns"], *spot, position, u)
        is_significant = gain is not None and gain.value > _MIN_GAIN_U * gain.standard_uncertainty
        if gain is None or (stated_gain is None and not is_significant):
            gain = gain or Estimate(np.nan, np.inf)
            by_axis[name] = uncorrected(*spot, gain, ReferenceVerdict.UNKNOWN_GAIN)
        else:
            by_axis[name] = subtract_common_motion(*spot, common, gain, quiet)
        corrected[name], corrected[f"u_{name}"] = by_axis[name].position_px, by_axis[name].u_px
    used = any(positions.verdict is ReferenceVerdict.USED for positions in by_axis.values())
    note = _reference_note(by_axis, is_stated=stated_gain is not None)
    return DeflectionCorrection(deflection_change(config, spots, corrected), used, note)


def _reference_note(by_axis: Mapping[str, CorrectedPositions], *, is_stated: bool) -> str:
    """Verdict on the reference spot, in one line, with the gain unless the configuration states it."""
    lost = int(np.count_nonzero(by_axis["x_px"].fallen_back))
    texts = []
    for name, positions in by_axis.items():
        has_own_gain = not is_stated and np.isfinite(positions.gain.value)
        gain = f" with a gain of {with_uncertainty(*positions.gain)} from the run itself"
        texts.append(f"{name[0]} {positions.verdict}{gain if has_own_gain else ''}")
    unchanged = f"; {lost} frames without it are unchanged" if lost else ""
    return f"reference spot: {', '.join(texts)}{unchanged}"


def deflection_change(
    config: Configuration, spots: np.ndarray, corrected: np.ndarray
) -> Callable[[Deflections], Deflections]:
    """Function that changes deflections, and their variances, as if the spots were the `corrected` ones."""
    deflector = optics_of(config, full_scale_dn=1.0).deflector((1, 1))
    old, new = (deflector(spots["time_ns"], _spots(table)) for table in (spots, corrected))
    times_ns = spots["time_ns"]
    shift = np.nan_to_num(np.stack([new.x - old.x, new.y - old.y]))
    variance = np.nan_to_num(np.stack([new.u_x**2 - old.u_x**2, new.u_y**2 - old.u_y**2]), nan=0.0)

    def correct(deflections: Deflections) -> Deflections:
        after = np.clip(np.searchsorted(times_ns, deflections.times_ns), 1, len(times_ns) - 1)
        is_nearer = deflections.times_ns - times_ns[after - 1] < times_ns[after] - deflections.times_ns
        rows = np.where(is_nearer, after - 1, after)
        (shift_x, shift_y), (variance_x, variance_y) = shift[:, rows], variance[:, rows]
        return replace(
            deflections,
            x=deflections.x + shift_x,
            y=deflections.y + shift_y,
            u_x=np.sqrt(deflections.u_x**2 + variance_x),
            u_y=np.sqrt(deflections.u_y**2 + variance_y),
        )

    return correct


class ChangedDeflections:
    """Deflections with a change of each block, at every iteration."""

    def __init__(self, blocks: Iterable[Deflections], change: Callable[[Deflections], Deflections]) -> None:
        self._blocks, self._change = blocks, change

    def __iter__(self) -> Iterator[Deflections]:
        return map(self._change, self._blocks)


_LIGHT_PICTURES = 48
"""Number of a record's whole frames in which fixed light is sought."""
_STEPS_PER_DN = 16
"""Steps a DN in which the light is subtracted from a picture."""
_MAX_LOST_FRACTION = 0.1
"""Largest fraction of the affected frames that may have no spot without the light."""
_MAX_SUBDIVIDED_DN = 4095
"""Largest full scale in DN at which `_STEPS_PER_DN` steps a DN fit into 16 bits."""


def without_fixed_light(reader: RecordReader, config: Configuration) -> DeflectionCorrection | None:
    """The correction for fixed light in the whole frames of a record; None where there is none.

    The affected frames are tracked again without the light, which needs the pixels around the spot. Where
    they lack, the correction is not used and the condition is not met; else the condition is a warning.
    """
    stride = max(1, reader.counts.get(IMAGE.topic, 0) // _LIGHT_PICTURES)
    images = {frame.sequence: frame.image for frame in reader.images(every=stride)}
    pictures = []
    for block in reader.spot_blocks(fields=("sequence", *Spot._fields)) if images else ():
        for row in np.flatnonzero(np.isin(block["sequence"], list(images))):
            spot = Spot(*(block[name][row].item() for name in Spot._fields))
            pictures.append((images[int(block["sequence"][row])], spot))
    light = fixed_light(pictures)
    if light is None:
        return None
    spots = np.concatenate(list(reader.spot_blocks(fields=_FIELDS)))
    is_affected = light.affects(spots["x_px"], spots["y_px"])
    # a learned profile depends on all frames
    is_tracked = is_affected | bool(np.any(spots["flags"] & SpotFlag.LEARNED))
    tracked = _track_again(reader, config, light, spots["sequence"][is_tracked])
    corrected, affected = spots.copy(), np.flatnonzero(is_affected)
    new_spots = [tracked.get(number) for number in spots["sequence"][affected].tolist()]
    for name in _POSITION_FIELDS:
        corrected[name][affected] = [np.nan if spot is None else getattr(spot, name) for spot in new_spots]
    lost = np.flatnonzero(is_affected & ~np.isfinite(corrected["x_px"]))
    used = len(lost) < _MAX_LOST_FRACTION * max(len(affected), 1)
    # a lost spot keeps its position with an uncertainty of 1 px, so that it has hardly any weight
    for name in _POSITION_FIELDS:
        corrected[name][lost] = 1.0 if name.startswith("u_") else spots[name][lost]
    reason = "the record has no pixels of the spot"
    if WINDOW.topic in reader.counts:
        reason = f"{percent(len(lost) / len(affected))} of these have no spot without it"
    outcome = "taken off" if used else f"not taken off, as {reason}"
    measured = f"pulls {len(affected)} of {len(spots)} ({percent(len(affected) / len(spots))}), {outcome}"
    verdict = Verdict("fixed light", used, light.text, NO_STRAY_LIGHT, measured, "none")
    return DeflectionCorrection(deflection_change(config, spots, corrected), used, verdict=verdict)


def _track_again(
    reader: RecordReader, config: Configuration, light: FixedLight, sequences: Ints
) -> dict[int, Spot]:
    """The spots of some frames, tracked again in their pixels less the light; without those lost."""
    steps = _STEPS_PER_DN if reader.full_scale_dn <= _MAX_SUBDIVIDED_DN else 1
    sensor = sensor_model(config, reader.full_scale_dn)
    full = steps * int(sensor.full_scale_dn)
    subtracted = np.rint(steps * light.subtracted_dn).astype(np.int64)
    gain, pedestal_dn = sensor.gain_e_per_dn / steps, steps * sensor.pedestal_dn
    fine = replace(sensor, gain_e_per_dn=gain, full_scale_dn=full, pedestal_dn=pedestal_dn)
    tracker = SpotTracker(fine)
    chosen, spots = set(sequences.tolist()), {}
    for window in reader.windows():
        if window.sequence not in chosen:
            continue
        (x0, y0), (ny, nx) = window.origin_px, window.image.shape
        pixels = steps * window.image.astype(np.int64)
        dark = np.maximum(pixels - subtracted[y0 : y0 + ny, x0 : x0 + nx], 0)
        image = np.where(pixels >= full, full, dark).astype(np.uint16)
        spot = tracker.track(image, window.origin_px, subtracted.shape)
        if not spot.flags & SpotFlag.LOST:
            spots[window.sequence] = spot
    return spots


def _spots(table: np.ndarray) -> list[Spot]:
    spots = np.zeros(len(table), dtype=SPOT_DTYPE)
    for name in _POSITION_FIELDS:
        spots[name] = table[name]
    return [Spot(*row) for row in spots.tolist()]
