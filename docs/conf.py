"""How sphinx makes the documentation site of the pages, the docstrings, the commands and the examples.

``make docs`` writes it to ``build/docs/html`` and fails where there is a warning.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import clrelight

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(Path(__file__).resolve().parent / "_ext"))

warnings.simplefilter("ignore", clrelight.Note)  # what the commands say on standard error, with paths of this machine

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
    "site_pages",
]
exclude_patterns = ["_ext", "**/README.md"]
suppress_warnings = ["config.cache"]  # a function of sphinx-gallery's settings cannot be pickled; all is built anew then
nitpicky = False

# Pages are read as GitHub reads them: headings have its anchors, a line of code without a language is plain.
myst_enable_extensions = ["dollarmath", "fieldlist"]
myst_heading_anchors = 4
highlight_language = "none"
default_role = "code"

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings have types with shapes and units, which annotations have not
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

sphinx_gallery_conf = {
    "examples_dirs": str(ROOT / "examples"),
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
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
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
}
html_show_sourcelink = False
html_show_copyright = False
