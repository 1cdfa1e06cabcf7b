"""Who is cited: keys are those of docs/bibliography.md, and no equation or figure stands without its paper."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = ("clrelight", "kernels", "datasets_synth", "benchmarks", "examples")
KEYS = set(re.findall(r"^\| `([a-z-]+)` \|", (ROOT / "docs" / "bibliography.md").read_text("utf-8"), re.MULTILINE))
_NUMBER = r"(?:\d|[IVX]+\b)"
PLACE = rf"(?:eqs?\.|[Ee]quations? \(?\d|figs?\.|[Ff]igures? \d|tables? {_NUMBER}|[Ss]ections? {_NUMBER}|appendix)"
BY_YEAR = re.compile(r"\b[A-Z]\w+(?:,? (?:and )?[A-Z]\w+)*(?: et al\.)?,? \(?(?:19|20)\d\d\b")
OF_ONE_PAPER = ("clrelight/reproduction/", "clrelight/cli/")
"""Modules whose paper is named in what they print, and the words of commands."""


def texts():
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".cl", ".clh"):
                # A citation may be broken by the end of a line of a comment.
                yield path.relative_to(ROOT).as_posix(), re.sub(r"\s*\n\s*[#*]?\s*", " ", path.read_text("utf-8"))


def unknown_keys(text):
    named = re.findall(rf"\b([a-z]{{3,}}(?:-[a-z]{{3,}}){{1,4}}),? {PLACE}", text, re.IGNORECASE)
    return {name.lower() for name in named} - KEYS


def is_anonymous(text):
    """Return whether a file names an equation, a figure, a table or a section, and nobody's."""
    cites = any(key in text.lower() for key in KEYS) or BY_YEAR.search(text)
    return bool(re.search(rf"\b{PLACE}", text)) and not cites


def test_every_key_is_of_the_bibliography_and_every_paper_cited():
    assert len(KEYS) == 5
    found = dict(texts())
    assert {path: unknown for path, text in found.items() if (unknown := unknown_keys(text))} == {}
    assert {key for key in KEYS if not any(key in text for text in found.values())} == set()


def test_no_equation_or_figure_stands_without_its_paper():
    assert [path for path, text in texts() if is_anonymous(text) and not path.startswith(OF_ONE_PAPER)] == []


@pytest.mark.parametrize(
    ("text", "unknown", "anonymous"),
    [
        ("the bound (noise-resistant-fitting, eq. 17)", set(), False),
        ("the bound (noise-resistent-fitting, eq. 17)", {"noise-resistent-fitting"}, True),
        ("Frequency-space-maps, table 3", {"frequency-space-maps"}, True),
        ("the height-correlated Smith term (Heitz 2014, eq. 99)", set(), False),
        ("the search of eq. 19", set(), True),
        ("a table of 3 rows, and equations", set(), False),
    ],
)
def test_what_would_be_found(text, unknown, anonymous):
    assert (unknown_keys(text), is_anonymous(text)) == (unknown, anonymous)
