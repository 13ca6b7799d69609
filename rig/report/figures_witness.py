"""What a witness of the ground explains of the drive: spectra before and after, and their coherence."""

from processing.fit import WitnessSpectra
from rig.report.drawing import ASYMPTOTIC, DATA, EXACT, INK, ReportFigure, canvas


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
