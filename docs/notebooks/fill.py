"""Runs the notebooks beside this file and writes what they print and draw into them.

    python docs/notebooks/fill.py

It needs runs/tutorial of the tutorial, and no Jupyter. A test runs the same cells.
"""

import base64
import contextlib
import io
import json
import os
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt

HERE = Path(__file__).resolve().parent


def run_cells(path: Path) -> dict[str, Any]:
    """The notebook with the outputs of its code cells, run one after the other in the present folder."""
    notebook: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    names: dict[str, Any] = {}
    count = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            count += 1
            cell["execution_count"], cell["outputs"] = count, _outputs("".join(cell["source"]), names)
    return notebook


def _outputs(source: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(source, names)
    lines = printed.getvalue().splitlines(keepends=True)
    outputs: list[dict[str, Any]] = []
    if lines:
        outputs.append({"name": "stdout", "output_type": "stream", "text": lines})
    for number in plt.get_fignums():
        png = io.BytesIO()
        plt.figure(number).savefig(png, format="png", dpi=80)
        plt.close(number)
        data = {"image/png": base64.b64encode(png.getvalue()).decode(), "text/plain": ["<Figure>"]}
        outputs.append({"data": data, "metadata": {}, "output_type": "display_data"})
    return outputs


if __name__ == "__main__":
    mpl.use("agg")
    os.chdir(HERE)
    for path in sorted(HERE.glob("*.ipynb")):
        text = json.dumps(run_cells(path), indent=1, ensure_ascii=False)
        path.write_text(text + "\n", encoding="utf-8")
        print(path.name)
