"""What the pages say is what the program does."""

import re
import tomllib
from statistics import median

import click
import pytest

from clrelight.cli.app import cli
from clrelight.experiment.toml import _TOML_KEYS
from clrelight.results import ROW_DTYPE
from clrelight.store.schemas import SCHEMAS
from datasets_synth.scenes import SCENES
from tests.commands import ROOT

DOCS = ROOT / "docs"


def fenced(page, language=""):
    return re.findall(rf"^```{language}\n(.*?)^```$", (DOCS / page).read_text(), re.S | re.M)


def test_experiments_page_shows_the_example():
    (shown,) = fenced("experiments.md", "toml")
    example = (ROOT / "examples" / "grid.toml").read_text()
    assert example.endswith(shown)
    assert tomllib.loads(shown) == tomllib.loads(example)


def test_experiments_page_names_every_key():
    page = (DOCS / "experiments.md").read_text()
    table = page[page.index("| key |") : page.index("A key, method")]
    missing = [key for key in _TOML_KEYS if not re.search(rf"`\[*{key}(\.ID)?\]*`", table)]
    assert missing == []
    assert [o.name for s in SCENES.values() for o in s.options if f"`{o.name}`" not in table] == []


@pytest.mark.parametrize("kind", SCHEMAS)
def test_files_page_names_every_field(kind):
    schema = SCHEMAS[kind]
    sections = re.split(r"^## ", (DOCS / "files.md").read_text(), flags=re.M)
    (section,) = (text for text in sections if text.startswith(f"`{schema.name}`"))
    names = [*(name.rstrip("/") for name in schema.fields), *schema.attributes]
    names += ROW_DTYPE.names if kind == "results" else ()
    assert [name for name in names if not re.search(rf"`{name}[`/]", section)] == []
    for name, field in schema.fields.items():
        if name.endswith("/"):
            continue
        (line,) = re.findall(rf"^\| `{name}` \| ([^|]*) \| ([^|]*) \|", section, re.M)
        assert line[0].split(", ") == list(field.axes)
        if len(field.dtypes) == 1 and field.dtypes[0].names is None:
            assert field.dtypes[0].name in line[1]


def test_commands_page_has_commands_that_exist():
    page = (DOCS / "commands.md").read_text()
    told = {word for title in re.findall(r"^## (.*)$", page, re.M) for word in title.split(", ")}
    assert set(cli.commands) <= told
    lines = re.findall(r"^\$ clrelight (.*)$", page, re.M)
    lines += re.findall(r"^clrelight (.*)$", "".join(fenced("../README.md")), re.M)
    for line in lines:
        words = line.split()
        command = cli.commands[words.pop(0)]
        if isinstance(command, click.Group):
            command = command.commands[words.pop(0)]
        known = {name for parameter in command.params for name in parameter.opts}
        assert [word for word in words if word.startswith("--") and word not in known] == [], line


def table(page, marker):
    """Return the rows of the tables between a page's markers."""
    text = (DOCS / page).read_text()
    block = text[text.index(f"<!-- {marker} -->") : text.index(f"<!-- /{marker} -->")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in block.split("\n") if line[:2] == "| "]


def test_readme_is_short_and_leads_on():
    text = (ROOT / "README.md").read_text()
    assert len(text.split()) <= 700
    linked = re.findall(r"\]\(([^)#:]+)", text)
    assert [name for name in linked if not (ROOT / name).is_file()] == []
    assert {page.name for page in DOCS.glob("*.md")} <= {name.removeprefix("docs/") for name in linked}
    for command in re.findall(r"^(?:\| .*)?`?(make \w+|python -m benchmarks\.\w+)", text, re.M):
        module, target = command.removeprefix("python -m ").replace(".", "/"), command.removeprefix("make ")
        assert (ROOT / f"{module}.py").exists() or re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.M)


def test_readme_figures_are_those_of_the_pages():
    """Each page's command renews its table; the README has the median and the worst of it."""
    ways = [row for row in table("which-basis.md", "rti") if len(row) == 9]
    behind = next((row[5], row[6]) for row in ways if row[0] == "auto")
    codecs = [float(row[2]) / float(row[5]) for row in table("codecs.md", "bytes")[1:] if row[5] not in ("", "–")]
    jobs = [row[10].split()[0] for row in table("performance.md", "growth") if len(row) == 15]
    speeds = [float(speed) for speed in jobs if speed[:1].isdigit()]
    shown = re.findall(r"^\| [^|]* \| ([\d.]+) \| ([\d.]+) \| `", (ROOT / "README.md").read_text(), re.M)
    assert shown == [
        behind,
        (f"{median(codecs):.1f}", f"{min(codecs):.1f}"),
        (f"{median(speeds):.2f}", f"{min(speeds):.2f}"),
    ]
    assert f"{max(speeds):.2f} where pictures are large" in (ROOT / "README.md").read_text()
    lead = f"{behind[0]} dB behind the best of eleven ways in the median, and {behind[1]} dB at worst"
    assert lead in (DOCS / "which-basis.md").read_text()


def test_what_is_said_of_peers_is_in_their_table():
    rows = table("peers.md", "peers")
    found = {}
    for way in ("JPEG 2000", "JPEG XL"):
        cells = [cell for row in rows if row[1:3] == [f"{way}, principal planes", "coding"] for cell in row[3:]]
        found[way] = [float(ratio) for cell in cells for ratio in re.findall(r"([\d.]+) ×", cell)]
        assert len(found[way]) == 15
    jpeg, xl = (f"{median(ratios):.2f}" for ratios in found.values())
    least = " and ".join(f"{min(ratios):.2f}" for ratios in found.values())
    text = (DOCS / "codecs.md").read_text()
    assert f"JPEG 2000 and JPEG XL take {jpeg} and {xl} times its bytes in the median ({least} at the least)" in text
