"""Cells that other programs write in ways of their own: read right, or refused in a line that quotes one."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from processing.errors import ConfigurationError, DataError
from rig.intake import clipping_warnings
from rig.intake.table import TableColumns

TIME_S = 0.05 * np.arange(400)
X = 10.0 * np.exp(-0.01 * TIME_S) * np.cos(2.0 * np.pi / 2.5 * TIME_S)


def _table(path: Path, cell: Callable[[float], str], header: str = "t_s,x_mm") -> Path:
    path.write_text(f"{header}\n" + "".join(f"{t:.3f},{cell(x)}\n" for t, x in zip(TIME_S, X, strict=True)))
    return path


@pytest.mark.parametrize("minus", ["\u2212", "\u2013"])
def test_a_typesetters_minus_is_a_minus(tmp_path: Path, minus: str) -> None:
    """Half of a swing is below its middle: left out, nothing of it would remain."""
    commas = "t_s;x_mm\n" + "".join(
        f"{t:.3f};{x:.4f}\n".replace(".", ",") for t, x in zip(TIME_S, X, strict=True)
    )
    (tmp_path / "c.csv").write_text(commas.replace("-", minus))
    for path in (
        _table(tmp_path / "a.csv", lambda x: f"{x:.4f}".replace("-", minus)),
        _table(tmp_path / "b.csv", lambda x: f"{x:.4f}°".replace("-", minus), "t_s,x"),
        tmp_path / "c.csv",
    ):
        np.testing.assert_allclose(TableColumns().read(path).positions[0], X, atol=1e-4)


@pytest.mark.parametrize(
    ("cell", "quoted"),
    [
        (lambda x: f"({-x:.4f})" if x < 0 else f"{x:.4f}", "'(0."),
        (lambda x: "1_0" if x < 0 else f"{x:.4f}", "'1_0'"),
        (lambda x: "over" if x < 0 else f"{x:.4f}", "'over'"),
    ],
)
def test_a_column_of_which_much_is_no_number_is_refused(
    tmp_path: Path, cell: Callable[[float], str], quoted: str
) -> None:
    path = _table(tmp_path / "decay.csv", cell)
    with pytest.raises(
        DataError, match=rf"200 of 400 values of x_mm are no numbers, first {re.escape(quoted)}.*line"
    ):
        TableColumns().read(path)


def test_single_words_infinities_and_empty_cells_are_missing_and_counted(tmp_path: Path) -> None:
    path = _table(tmp_path / "decay.csv", lambda x: f"{x:.4f}")
    lines = path.read_text().splitlines()
    for line, cell in enumerate(("inf", "1e999", "-Infinity", "NaN", "over", "1_0"), start=100):
        lines[line - 1] = f"{lines[line - 1].split(',')[0]},{cell}"
    path.write_text("\n".join(lines))
    found = TableColumns().read(path)
    assert np.flatnonzero(~np.isfinite(found.positions[0])).tolist() == list(range(98, 104))
    assert (
        "missing from the fit: 6 values of position 1 that are not numbers (lines 100 to 105)"
        in found.understood
    )


def test_a_second_position_that_was_never_measured_is_named(tmp_path: Path) -> None:
    rows = "".join(f"{0.05 * k:.2f},{10 * np.cos(k / 8):.4f},nan\n" for k in range(400))
    (path := tmp_path / "decay.csv").write_text(f"t_s,x_deg,y_deg\n{rows}")
    with pytest.raises(DataError, match="y_deg"):
        TableColumns(positions=("x_deg", "y_deg")).read(path)


def test_an_angle_may_swing_about_any_place_of_its_circle_but_not_by_more_than_a_turn(tmp_path: Path) -> None:
    """An encoder counts from its own zero, and a column called t is in seconds, which are no days."""
    found = TableColumns().read(_table(tmp_path / "far.csv", lambda x: f"{300.0 + x:.4f}", "t,x_deg"))
    np.testing.assert_allclose(found.positions[0], 300.0 + X, atol=1e-4)
    with pytest.raises(ConfigurationError, match="more than a turn"):
        TableColumns().read(_table(tmp_path / "mm.csv", lambda x: f"{40.0 * x:.4f}", "t,x_deg"))


@pytest.mark.parametrize(
    ("low", "high", "digits", "said"),
    [
        (0.0, 20.0, 3, ["smallest"]),
        (-5.0, 5.0, 3, ["smallest", "largest"]),
        (-20.0, 20.0, 3, []),
        # coarse steps, as of whole pixels
        (-20.0, 20.0, 0, []),
    ],
)
def test_a_range_that_cuts_turning_points_off_is_said(
    low: float, high: float, digits: int, said: list[str]
) -> None:
    t = np.arange(1200) * 0.05
    x = np.clip(10.0 * np.exp(-0.02 * t) * np.cos(np.pi * t + 0.3), low, high)
    lines = clipping_warnings("phi", np.round(x, digits))
    assert [word for word in ("smallest", "largest") for line in lines if f"its {word} value" in line] == said
