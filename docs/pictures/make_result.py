"""Makes result.png beside this file from the report of a session: decay, period, loops, losses.

rig run configs/demo.toml -o DIR
python docs/pictures/make_result.py DIR
"""

import sys
from pathlib import Path

import cv2
import numpy as np

FIGURES = (("fig12-decay", "fig13-period"), ("table4-loops", "losses"))
WIDTH_PX = 1600


def main(session: Path) -> None:
    """Four figures of the first run on one white sheet."""
    rows = []
    for names in FIGURES:
        images = [read(session / "report" / "run-1" / f"{name}.png") for name in names]
        height = max(image.shape[0] for image in images)
        rows.append(np.hstack([padded(image, height) for image in images]))
    sheet = np.vstack(rows)
    height_px = round(sheet.shape[0] * WIDTH_PX / sheet.shape[1])
    sheet = cv2.resize(sheet, (WIDTH_PX, height_px), interpolation=cv2.INTER_AREA)
    target = Path(__file__).resolve().with_name("result.png")
    cv2.imwrite(str(target), sheet, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{target.name}: {target.stat().st_size / 1000:.0f} kB")


def read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    if image is None:
        raise SystemExit(f"{path}: cannot be read; rig report makes it")
    return image


def padded(image: np.ndarray, height: int) -> np.ndarray:
    return cv2.copyMakeBorder(image, 0, height - image.shape[0], 0, 0, cv2.BORDER_CONSTANT, value=(255,) * 3)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("usage: python docs/pictures/make_result.py SESSION_FOLDER")
    main(Path(sys.argv[1]))
