"""What the papers print beside ours: the registry is whole, quick rows agree, verdicts can fail."""

import math
from dataclasses import replace

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.reproduction import registry
from clrelight.reproduction.page import page, write_page, write_pictures
from clrelight.reproduction.registry import PAPERS, choose
from clrelight.reproduction.rows import AGREES, DIFFERS, FAILS, NEEDS_DATA, OUT, Between, Found, Holds, Near, Row, Work
from clrelight.reproduction.run import judge, reproduce
from tests.commands import ROOT, call, succeed

NAMED = {  # what is printed and can be recomputed
    "fitting": ["table I", "table II", "table III", "figure 2", *(f"figure {n}" for n in range(4, 16))],
    "irradiance": ["figure 1", "figure 2", "figure 3", "figure 4", "bounds", "500×", "equation 9", "equation 12"],
    "gritty": ["two lobes", "figure 6", *(f"figure {n}" for n in range(8, 16))],
    "frequency": ["table 2", "table 3", "table 4", "table 5", "figure 1", *(f"figure {n}" for n in range(5, 11))],
    "variation": [f"figure {n}" for n in range(1, 9)],
}
DECLARED_OUT = ("near-field", "structure from video", "subsurface")


@pytest.mark.parametrize("paper", NAMED)
def test_every_printed_item_has_a_row_or_a_reason(paper):
    for item in NAMED[paper]:
        found = choose(paper, [item])[0]
        rows = [row for work in found.works for row in work.rows if registry._means(item, row.item)]
        assert rows or found.out, item  # a picture alone is no verdict


def test_the_page_has_every_row():
    """It takes minutes to make, so that a new row is easily left out of it."""
    written = (ROOT / "docs" / "reproduction.md").read_text("utf-8").splitlines()
    rows = [row for paper in PAPERS.values() for work in paper.works for row in work.rows]
    missing = [row for row in rows if not any(line.startswith(f"| {row.item} | {row.what} |") for line in written)]
    assert missing == []


def test_what_is_declared_out_says_so():
    texts = [f"{each.what} {each.item} {each.reason}" for paper in PAPERS.values() for each in paper.out]
    for word in DECLARED_OUT:
        assert any(word in text for text in texts), word


def test_rows_are_told_apart_and_say_what_they_need():
    for paper in PAPERS.values():
        names = [(row.item, row.what) for work in paper.works for row in work.rows]
        assert len(names) == len(set(names))
        for work in paper.works:
            assert work.rows
            assert work.takes in ("quick", "short", "long")
            for row in work.rows:
                assert row.what, row
                assert row.printed, row
                assert row.where, row
                assert (row.expected is None) == (not row.reason) or row.expected is None
                if row.expected is not None:
                    assert row.reason, row  # a number that may differ says why


def test_tolerances():
    assert Near(0.5, 0.1).holds(0.55)
    assert not Near(0.5, 0.1).holds(0.65)
    assert not Near(0.5, 0.1).holds(math.nan)
    assert Near((1.0, 2.0), 0.1).holds((1.05, 1.95))
    assert not Near((1.0, 2.0), 0.1).holds((1.05, 2.2))
    assert not Near((1.0, 2.0), 0.1).holds((1.05,))
    assert Between(1.0, 2.0).holds(2.0)
    assert not Between(1.0).holds(0.9)
    assert not Between(1.0, 2.0).holds(math.nan)
    assert Holds().holds(1.0)
    assert not Holds().holds(0.0)
    assert [str(each) for each in (Near(1, 0.1), Between(1), Between(most=2), Between(1, 2), Holds())] == [
        *("±0.1", "≥ 1", "≤ 2", "1 to 2", "yes")
    ]


def test_verdicts():
    row = Row("table I", "PSNR", "32.21", "table I", "psnr", Near(32.21, 0.5), Near(25.7, 0.7), "another ring")
    assert [row.judge(value) for value in (32.0, 25.5, 28.0, math.nan)] == [AGREES, DIFFERS, FAILS, FAILS]
    assert replace(row, expected=None, reason="").judge(25.5) == FAILS


def test_every_tolerance_can_fail():
    for paper in PAPERS.values():
        for row in (row for work in paper.works for row in work.rows):
            count = len(row.agrees.numbers) if isinstance(getattr(row.agrees, "numbers", 0), tuple) else 1
            wrong = [value if count == 1 else (value,) * count for value in (math.nan, 1e9, -1e9)]
            nothing, *far = (row.judge(value) for value in wrong)
            assert nothing == FAILS, row.what
            assert FAILS in far, row.what


@pytest.fixture(scope="module")
def quick():
    return reproduce(choose(None, quick=True), draws=False)


def test_quick_rows_agree_or_differ_for_their_reason(quick):
    assert [(each.paper, each.what, each.ours) for each in quick.outcomes if each.verdict == FAILS] == []
    assert quick.counts()[AGREES] > 50
    assert all(each.reason for each in quick.outcomes if each.verdict in (DIFFERS, NEEDS_DATA, OUT))
    printed = next(each for each in quick.outcomes if each.item == "equation 9")
    assert (printed.printed[:7], printed.ours[:5], printed.verdict) == ("3.14159", "3.142", AGREES)


def test_a_perturbed_value_fails(quick):
    """Far from where they are no values pass, whatever the tolerance."""
    judged = fails = 0
    for paper in choose(None, quick=True):
        for work in paper.works:
            if work.needs:
                continue
            values = work.run(_bench()).values if work.name in ("formulas", "two lobes", "caps", "rotation") else {}
            for row in work.rows:
                if row.value not in values:
                    continue
                found = values[row.value]
                moved = tuple(v + 3000.1 for v in found) if isinstance(found, tuple) else found + 3000.1
                judged += 1
                fails += judge(paper, [row], {row.value: moved})[0].verdict == FAILS
    assert judged > 30
    assert fails == judged


def _bench():
    from clrelight.reproduction.rows import Bench

    return Bench(None, lambda: pytest.fail("a quick work without data opens no device"), draws=False)


def test_a_value_that_is_not_computed_fails():
    paper = PAPERS["variation"]
    outcome = judge(paper, paper.works[0].rows[:1], {})[0]
    assert (outcome.verdict, outcome.reason) == (FAILS, "not computed")


def test_rows_without_their_data_are_told_not_computed(tmp_path):
    made = reproduce(choose("irradiance", ["figure 2"]), data=tmp_path, draws=False)
    needed = [each for each in made.outcomes if each.verdict == NEEDS_DATA]
    assert len(needed) == 9
    assert "grace_cross.hdr" in needed[0].reason
    assert made.holds
    with pytest.raises(InputError, match="is no folder"):
        reproduce([], data=tmp_path / "nowhere")


def test_coefficients_of_grace_cathedral_are_the_printed(real_data):
    made = reproduce(choose("irradiance", ["figure 2"]), data=real_data, draws=False)
    assert [each.verdict for each in made.outcomes].count(AGREES) == 9


def test_items_are_found_as_people_name_them():
    assert [work.name for work in choose("variation", ["7"])[0].works] == ["formulas"]
    assert [row.item for row in choose("fitting", ["Table III"])[0].works[0].rows] == ["table III"] * 12
    assert [work.name for work in choose("gritty", ["figure 7"])[0].works] == ["functions"]
    with pytest.raises(InputError, match=r"nothing is known of 'figure 99'; there are .*figure 5"):
        choose("variation", ["figure 99"])
    with pytest.raises(InputError, match="papers are fitting, irradiance, gritty, frequency, variation, got 'lam'"):
        choose("lam")


def test_page_and_pictures(tmp_path):
    chosen = choose("variation", ["figure 6"])
    made = reproduce(chosen)
    folder = tmp_path / "images"
    assert write_pictures(folder, made) == ["variation_figure6.png"]
    assert (folder / "variation_figure6.png").stat().st_size > 1000
    write_page(tmp_path / "page.md", made, chosen, folder)
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "![figure 6](images/variation_figure6.png)" in text
    assert "| figure 6 | entries between orders, by quadrature, at most | 0 | figure 6 | " in text
    assert "images/" not in page(made, chosen, "").split("## ")[1]


def test_command(tmp_path, monkeypatch):
    monkeypatch.delenv("CLRELIGHT_DATA", raising=False)
    told = succeed("reproduce", "gritty", "16", "--json").json
    assert told["verdicts"] == {"agrees": 1}
    assert told["rows"][0]["ours"] == "3"
    assert "overcast" in succeed("reproduce", "gritty", "16").out
    assert "figure 15" in succeed("reproduce", "--list").out
    assert call("reproduce", "gritty", "figure 99").code == 2
    refused = call("reproduce", "gritty", "16", "--markdown", tmp_path / "none" / "page.md")
    assert (refused.code, "there is no folder" in refused.err) == (2, True)


def test_exit_code_is_1_where_a_verdict_fails(monkeypatch):
    paper = PAPERS["variation"]
    row = Row("figure 8", "a number", "1", "figure 8", "a", Near(1.0, 0.1))
    work = Work("wrong", (row,), lambda bench: Found({"a": np.pi}))
    monkeypatch.setitem(registry.PAPERS, "variation", replace(paper, works=[work], out=[]))
    monkeypatch.delenv("CLRELIGHT_DATA", raising=False)
    ended = call("reproduce", "variation", "--json")
    assert (ended.code, ended.json["verdicts"]) == (1, {"FAILS": 1})
