"""How sphinx makes the documentation site of the pages, the docstrings, the commands and the examples.

``make docs`` writes it to ``build/docs/html`` and fails where there is a warning.
"""

from __future__ import annotations

import re
import warnings
from typing import Any

import clrelight

warnings.simplefilter("ignore", clrelight.Note)  # of the examples: lines that name paths of this machine

project = "clrelight"
author = "The clrelight authors"
copyright = author
release = version = clrelight.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx_click",
    "sphinx_gallery.gen_gallery",
]

# Pages are read as GitHub reads them: headings have its anchors, a line of code without a language is plain.
myst_enable_extensions = ["dollarmath", "fieldlist"]
myst_heading_anchors = 4
highlight_language = "none"
smartquotes = False  # -- of options stays two signs
default_role = "code"

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings have types with shapes and units, which annotations have not
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "capture_repr": (),
    "show_memory": False,
    "abort_on_example_error": True,
    "remove_config_comments": True,
    "min_reported_time": 1000,
    "write_computation_times": False,
}

html_theme = "pydata_sphinx_theme"
html_title = f"clrelight {release}"
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 8,
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
}
html_show_sourcelink = False
html_show_copyright = False

_ABOVE = re.compile(r"\[([^\]]*)\]\(\.\./([^)\s]+)\)")
"""A link from a page to a file above docs/."""


def _stay_inside(app: Any, docname: str, source: list[str]) -> None:
    """Leave the words of links to files of the repository that the site has not."""
    source[0] = _ABOVE.sub(r"\1", source[0])


def setup(app: Any) -> None:
    """Register with sphinx."""
    app.connect("source-read", _stay_inside)
