"""Configuration of the documentation site; ``make docs`` builds it into build/docs."""

import os
import re
import sys
from importlib.metadata import version as version_of
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parents[1]))
os.environ.setdefault("MUJOCO_GL", "off")  # modules are imported for their docstrings; nothing is rendered

from docs.generate import show_figures
from sim.settings import Group

project = "DeepGPS testbed"
author = "The DeepGPS testbed developers"
project_copyright = author
version = release = version_of("deepgps")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
]
exclude_patterns = ["examples"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
napoleon_use_rtype = False
napoleon_use_ivar = True
autodoc_default_options = {"exclude-members": "model_config"}
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_format = "short"
autodoc_typehints_description_target = "documented_params"
default_role = "literal"
smartquotes_action = "qe"  # quotes and dots; two dashes begin an option
copybutton_prompt_text = "$ "

html_theme = "furo"
html_title = f"DeepGPS testbed {release}"
html_static_path = ["_static"]
html_css_files = ["style.css"]
html_show_sphinx = False
html_copy_source = False


TABLES = "\n```{toctree}\n:hidden:\n:glob:\n\nresults/*/table\n```\n"
"""The pages below that of all tables, of which a reader in the repository sees links."""


def setup(app: Sphinx) -> None:
    """Add figures to results, and leave out what Python itself says of a tuple's fields."""
    app.connect("autodoc-skip-member", lambda *details: "Alias for field number" in str(details[3].__doc__) or None)
    app.connect("autodoc-process-signature", _shorten_settings)
    app.connect("source-read", lambda _app, page, source: source.__setitem__(0, _complete(source[0], page)))


def _complete(text: str, page: str) -> str:
    """A page's text with a study's figures, or the pages below it; "RMS / median / max" stays on one line."""
    text += show_figures(page) if page.startswith("results/") else TABLES if page == "tables" else ""
    return re.sub(r"(?<=\d) / (?=\d)", "\u00a0/\u00a0", text)


def _shorten_settings(_app: Sphinx, _what: str, _name: str, thing: object, *_: object) -> tuple[str, None] | None:
    """Leave the defaults of all settings out of a signature: the page of settings has them."""
    return ("(**settings)", None) if isinstance(thing, type) and issubclass(thing, Group) else None
