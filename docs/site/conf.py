"""How the documents become a site: `make docs` writes it to build/site, without a network.

The documents are the files that are read in the repository. Pages that follow from the program (commands,
keys, schemas) state `<!-- generated: NAME -->`; `generated.py` writes their content while the site is built.
"""

import re
import sys
from importlib import metadata
from pathlib import Path

from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(ROOT), str(HERE)]

from generated import PAGES  # noqa: E402

project = "Optical pendulum rig"
author = "the project"
release = metadata.version("optical-pendulum-rig")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "README"
include_patterns = ["README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "docs/**.md"]
exclude_patterns = [".*", "build", "dist", "runs", "tests", "rig", "acquisition", "calibration", "processing"]

html_theme = "furo"
html_title = f"{project} {release}"
html_show_copyright = False
html_copy_source = False
highlight_language = "none"
# two dashes of an option stay two dashes
smartquotes = False
myst_heading_anchors = 4
# decisions name files in single backticks, docstrings names of arguments
default_role = "code"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
python_display_short_literal_types = True
maximum_signature_line_length = 80

CONTENTS = {
    "Start": ["docs/start", "docs/troubleshooting"],
    "The instrument": ["docs/build", "docs/controller", "docs/cameras", "docs/calibrate"],
    "Measure": ["docs/measure", "docs/desk", "docs/results"],
    "Other data, many runs": ["docs/other-data", "docs/many-runs", "docs/scripts"],
    "Reference": [
        "docs/reference/commands",
        "docs/reference/configuration",
        "docs/reference/results",
        "docs/reference/archive",
        "docs/reference/record",
        "docs/reference/topics",
        "docs/reference/python",
        "docs/reference/notebook",
        "docs/validation",
        "docs/benchmarks",
        "CHANGELOG",
    ],
    "Develop": ["CONTRIBUTING", "docs/extending", "docs/decisions/README", "SECURITY"],
}
GENERATED = re.compile(r"^<!-- generated: ([\w-]+) -->$", re.MULTILINE)
INDEX = (
    '<!doctype html><meta http-equiv="refresh" content="0; url=README.html"><a href="README.html">Start</a>\n'
)


def complete(app: Sphinx, name: str, source: list[str]) -> None:
    """Write generated content, and the contents of the site below README's text."""
    source[0] = GENERATED.sub(lambda match: PAGES[match[1]](), source[0])
    if name == root_doc:
        source[0] += "".join(tree(caption, pages) for caption, pages in CONTENTS.items())
    elif name == "docs/decisions/README":
        source[0] += tree("", sorted(path.stem for path in (ROOT / "docs" / "decisions").glob("0*.md")))


def tree(caption: str, pages: list[str]) -> str:
    """Pages of the site's contents."""
    option = f":hidden:\n:caption: {caption}\n" if caption else ":maxdepth: 1\n"
    return "\n```{toctree}\n" + option + "\n" + "\n".join(pages) + "\n```\n"


def finish(app: Sphinx, exception: Exception | None) -> None:
    """The site's first page is README's."""
    if exception is None:
        (Path(app.outdir) / "index.html").write_text(INDEX, encoding="utf-8")


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", complete)
    app.connect("build-finished", finish)
