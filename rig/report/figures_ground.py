"""What the samples hold besides the swing, how much could be the ground, and what a witness explains."""

import numpy as np
from matplotlib.axes import Axes

from processing.fit import BaseMotion, Ground, WitnessSpectra
from processing.noise_models import density_of_db, nhnm_db, nlnm_db
from processing.swing import ResidualSpectrum
from rig.presentation import palette
from rig.report.drawing import ASYMPTOTIC, DATA, EXACT, INK, Array, ReportFigure, canvas

_NANO = 1e9
_BINS_A_DECADE = 40


def spectrum_figure(
    spectrum: ResidualSpectrum, shown_unit: str, shown_size: float, ground: Ground | None
) -> ReportFigure:
    """Spectrum of what is left of the deflection, and as an acceleration of the base for a known height.

    Parameters
    ----------
    shown_unit, shown_size
        Unit of deflections for display and its size in the spectrum's unit.
    ground
        Of the exact fit. Its drive stands in the picture at the pendulum's frequency.
    """
    base = None if ground is None else ground.base
    figure = canvas(2.7 if base is None else 2.9)
    left = figure.add_subplot(1, 1 if base is None else 2, 1)
    frequency_hz, density = _binned(spectrum)
    left.loglog(frequency_hz, np.sqrt(density) / shown_size, color=DATA, lw=0.9)
    left.set_ylabel(f"deflection / {shown_unit}/√Hz")
    _frequency_axis(left, spectrum)
    words = (
        "Deflections of the slow mode after subtracting the swing, from 2.2 times the pendulum's frequency "
        "(dotted) on, without its odd harmonics: sensor, air and ground."
    )
    if base is not None and ground is not None:
        right = figure.add_subplot(1, 2, 2)
        _as_acceleration(right, spectrum, frequency_hz, density, ground, base)
        words += (
            " Right: the acceleration of the base that alone would cause this, for a centre of mass "
            f"{1e3 * base.mass_centre_height_m:.3g} mm above the contact: an upper limit for the ground. "
            "The point is the drive that the fit finds at the pendulum's frequency (an arrow: its bound of "
            "95 %); NLNM and NHNM are Peterson's noise models of 1993."
        )
    figure.subplots_adjust(left=0.12, right=0.985, bottom=0.17, top=0.96, wspace=0.26)
    return ReportFigure("spectrum", "What remains after subtracting the swing", words, figure)


def _as_acceleration(
    axes: Axes,
    spectrum: ResidualSpectrum,
    frequency_hz: Array,
    density: Array,
    ground: Ground,
    base: BaseMotion,
) -> None:
    drive, bound = ground.density_rad_per_s2_rthz, ground.upper_95
    # both are of the same drive: their ratio is what the base has to do for it
    per_drive = base.upper_95 / bound
    rad_per_acceleration = 1 / (per_drive * (2 * np.pi * spectrum.pendulum_hz) ** 2)
    answer = spectrum.pendulum_hz**2 / (frequency_hz**2 - spectrum.pendulum_hz**2)
    axes.loglog(frequency_hz, _NANO * np.sqrt(density) / (rad_per_acceleration * answer), color=DATA, lw=0.9)
    span = np.geomspace(0.5 * spectrum.pendulum_hz, frequency_hz[-1], 200)
    for model, name in ((nlnm_db, "NLNM"), (nhnm_db, "NHNM")):
        level = _NANO * density_of_db(model(span))
        axes.loglog(span, level, color=palette.GREY, lw=0.9)
        axes.annotate(
            name,
            (span[-1], level[-1]),
            (-2, 3),
            textcoords="offset points",
            ha="right",
            color=INK,
            fontsize=7.5,
        )
    at = [spectrum.pendulum_hz]
    if ground.seen:
        u = [_NANO * drive.standard_uncertainty * per_drive]
        axes.errorbar(at, [_NANO * drive.value * per_drive], yerr=u, fmt="o", color=EXACT, ms=4, capsize=2)
    else:
        top = _NANO * bound * per_drive
        axes.errorbar(at, [top], yerr=[0.6 * top], uplims=True, fmt="_", color=EXACT, ms=7)
    axes.set_ylabel("acceleration of the base / nm/s²/√Hz")
    _frequency_axis(axes, spectrum)


def _frequency_axis(axes: Axes, spectrum: ResidualSpectrum) -> None:
    axes.axvline(spectrum.pendulum_hz, color=INK, lw=0.7, ls=":")
    axes.set_xlim(0.5 * spectrum.pendulum_hz, float(spectrum.frequency_hz[-1]))
    axes.set_xlabel("frequency / Hz")


def _binned(
    spectrum: ResidualSpectrum,
) -> tuple[Array, Array]:
    """Means over bins of equal width in log frequency: a line that can be read on a logarithmic scale."""
    bins = np.round(np.log10(spectrum.frequency_hz) * _BINS_A_DECADE)
    _, start = np.unique(bins, return_index=True)
    count = np.diff([*start, len(bins)])
    return (
        np.asarray(np.add.reduceat(spectrum.frequency_hz, start) / count),
        np.asarray(np.add.reduceat(spectrum.density, start) / count),
    )


def witness_figure(spectra: WitnessSpectra) -> ReportFigure:
    """Spectra near the pendulum's frequency, and the squared coherence of pendulum and witness."""
    frequency_hz = spectra.frequency_hz
    figure = canvas(2.9)
    left, right = figure.subplots(1, 2, width_ratios=[1.4, 1.0])
    for density, colour, line, name in (
        (spectra.pendulum_rad_per_s2_rthz, DATA, "-", "pendulum"),
        (spectra.witness_rad_per_s2_rthz, ASYMPTOTIC, "-", "witness"),
        (spectra.left_rad_per_s2_rthz, EXACT, "-", "what is left"),
        (spectra.measurement_rad_per_s2_rthz, INK, ":", "measurement alone"),
    ):
        # an error of a turning point moves no drive at the pendulum's own frequency
        shown = [(f, d) for f, d in zip(frequency_hz, density, strict=True) if d > 0]
        left.semilogy(*zip(*shown, strict=True), color=colour, ls=line, lw=1.0, label=name)
    left.set_ylabel("drive / rad/s²/√Hz")
    left.legend(loc="best")
    right.plot(frequency_hz, spectra.coherence, color=DATA, lw=1.0)
    right.axhline(1 / spectra.stretches, color=INK, lw=0.7, ls="--")
    right.set_ylim(0.0, 1.02)
    right.set_ylabel("squared coherence")
    for axes in (left, right):
        axes.set_xlim(frequency_hz[0], frequency_hz[-1])
        axes.axvline(0.5 * (frequency_hz[0] + frequency_hz[-1]), color=INK, lw=0.7, ls=":")
        axes.set_xlabel("frequency / Hz")
    figure.subplots_adjust(left=0.1, right=0.985, bottom=0.17, top=0.96, wspace=0.26)
    return ReportFigure(
        "witness",
        "What the witness of the ground explains",
        "Left: the drive near the pendulum's frequency (dotted) as its turning points show it, as the "
        "witness predicts it with the fitted response, and the remainder; also the apparent drive from the "
        "uncertainties of the turning points alone, which grows away from that frequency. "
        "Right: the squared coherence of pendulum and witness, over "
        f"{spectra.stretches} stretches of the run (dashed: what unrelated records would show).",
        figure,
    )
