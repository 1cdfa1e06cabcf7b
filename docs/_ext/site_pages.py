"""Links of the pages to files of the repository that are no pages: the site gets a copy of each to download."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

_PAGES = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md", "README.md": "index.md"}
"""Files above docs/ that the site has as pages."""
_LINK = re.compile(r"\[([^\]]*)\]\((?:\.\./|docs/)([^)#\s]+)(#[^)\s]*)?\)")


def link_inside(text: str, folder: Path) -> str:
    """Return a page's Markdown with its links to files outside the folder turned into what the site has.

    Parameters
    ----------
    text : str
    folder : Path
        Of the pages.

    Returns
    -------
    str
        Links to pages stay links; of another file stands the name alone.
    """

    def replace(match: re.Match[str]) -> str:
        words, name, anchor = match[1], match[2], match[3] or ""
        page = _PAGES.get(name, name if (folder / name).is_file() else "")
        return f"[{words}]({page}{anchor})" if page else words

    return _LINK.sub(replace, text)


def _read(app: Any, docname: str, source: list[str]) -> None:
    if app.env.doc2path(docname).suffix == ".md":
        source[0] = link_inside(source[0], Path(app.srcdir))


def setup(app: Any) -> dict[str, bool]:
    """Register with sphinx."""
    app.connect("source-read", _read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
