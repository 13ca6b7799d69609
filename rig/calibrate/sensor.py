"""`rig calibrate sensor`: gain, read noise and dark level by photon transfer."""

from pathlib import Path

from calibration import photon_transfer
from processing.errors import ConfigurationError, DataError
from rig.calibrate.filing import Filing, details_of, file_calibration
from rig.calibrate.inputs import frames_of, read_transfer


def calibrate_sensor(frames: Path, filing: Filing) -> Path:
    """Photon transfer from pairs of dark and of uniformly lit frames: see `read_transfer`."""
    table = read_transfer(frames)
    place = frames.parent
    named = {"darks": table.darks, **{f"level.{n}.frames": item.frames for n, item in enumerate(table.level)}}
    missing = [f"{key} = '{name}'" for key, name in named.items() if not (place / name).exists()]
    if missing:
        raise ConfigurationError(
            f"{frames}: {', '.join(missing)}: no such record, folder or file of frames in {place.resolve()}, "
            "where this list lies"
        )
    darks, full_scale = frames_of(place / table.darks)
    pairs, sources = [], [frames, place / table.darks]
    for level in table.level:
        images, scale = frames_of(place / level.frames)
        if len(images) < 2:
            raise DataError(f"{level.frames}: holds {len(images)} frame; a pair is needed at each level")
        if scale != full_scale or images[0].shape != darks[0].shape:
            raise DataError(f"{level.frames}: frames of another shape or depth than those in {table.darks}")
        pairs.append((images[0], images[1]))
        sources.append(place / level.frames)
    exposures = [level.exposure_us for level in table.level if level.exposure_us is not None]
    found = photon_transfer(
        pairs,
        darks,
        table.full_scale_dn or full_scale,
        names=[str(level.frames) for level in table.level],
        exposures_us=exposures if len(exposures) == len(pairs) else [],
    )
    values = {
        "gain_e_per_dn": found.gain_e_per_dn,
        "read_noise_e": found.read_noise_e,
        "full_scale_dn": float(table.full_scale_dn or full_scale),
        "pedestal_dn": found.dark_level_dn,
        # an insignificant spread would only make the tracker's weights worse
        "prnu": found.prnu if found.prnu > 2.0 * found.u_prnu else 0.0,
    }
    details = details_of(
        found, "gain_e_per_dn", "read_noise_e", "dark_level_dn", "points", "hot_pixels", "rejected"
    )
    details["signal_dn"] = [point.signal_dn for point in found.points]
    details["variance_dn2"] = [point.variance_dn2 for point in found.points]
    details["u_variance_dn2"] = [point.u_variance_dn2 for point in found.points]
    details["hot_pixels_xy"] = found.hot_pixels.tolist()
    return file_calibration(
        "sensor", filing, "photon transfer (EMVA 1288)", values, details, sources, found.rejected
    )
