"""What the pages say is what the program does."""

import re
import tomllib

import click
import pytest

from clrelight.cli.app import cli
from clrelight.experiment.toml import _RING_KEYS, _TOML_KEYS
from clrelight.results import ROW_DTYPE
from clrelight.store.schemas import SCHEMAS
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
    assert [key for key in _RING_KEYS if f"`{key}`" not in table] == []


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
    for line in re.findall(r"^\$ clrelight (.*)$", page, re.M):
        words = line.split()
        command = cli.commands[words.pop(0)]
        if isinstance(command, click.Group):
            command = command.commands[words.pop(0)]
        known = {name for parameter in command.params for name in parameter.opts}
        assert [word for word in words if word.startswith("--") and word not in known] == [], line
