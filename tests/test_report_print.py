"""The report on paper and on a phone: nothing is cut, and what only works on a screen is not printed."""

import re

import pytest

from clrelight.report import write_report
from tests.browser import find_chromium, opened_browser
from tests.test_report_page import hostile_results

OUTSIDE = """
  [...document.querySelectorAll("body *")].filter((each) => each.getBoundingClientRect().right > innerWidth + 1
    && !each.closest("SCROLLED") && !each.closest("svg > *")).map((each) => each.outerHTML.slice(0, 80))
"""
PRINTED = """(() => {
  const all = (chosen) => [...document.querySelectorAll(chosen)];
  const style = (chosen) => getComputedStyle(document.querySelector(chosen));
  const wide = all("table").find((each) => each.caption.textContent.includes("All rows")).parentElement;
  return {
    seen: all("input, select, nav, .downloads").filter((each) => each.offsetParent).length,
    button: style("thead button").display,
    how: style(".how").breakAfter,
    wide: [wide, wide.previousElementSibling].map((each) => getComputedStyle(each).page),
    table: style("table").page,
    drags: document.body.innerText.includes("Drag"),
  };
})()"""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "out"
    write_report(hostile_results(), out)
    return out / "report.html"


@pytest.mark.skipif(not find_chromium(), reason="no Chromium is installed: apt-get install chromium")
def test_nothing_is_cut_on_paper_and_phones(written):
    with opened_browser(written.as_uri(), width=390, height=844, mobile=True) as page:
        assert page.evaluate(OUTSIDE.replace("SCROLLED", ".scroll > *")) == []
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        assert page.evaluate('document.body.innerText.includes("Drag the line")')
        page.call("Emulation.setEmulatedMedia", media="print")
        size = {"height": 1400, "deviceScaleFactor": 1, "mobile": False}
        for width, others in ((717, ".wide"), (1046, "none")):  # A4 upright and lying, less margins of 1 cm, at 96 dpi
            page.call("Emulation.setDeviceMetricsOverride", width=width, **size)
            assert page.evaluate(OUTSIDE.replace("SCROLLED", others)) == []
        printed = page.evaluate(PRINTED)
    # A heading with buttons in it would not be repeated on the next sheet.
    expected = {"seen": 0, "button": "contents", "how": "avoid", "wide": ["wide", "wide"], "table": "auto"}
    expected["drags"] = False
    assert printed == expected


def test_long_words_alone_may_be_broken(written):
    text = written.read_text(encoding="utf-8")
    assert re.search(r'<td class="words long"[^>]*>&lt;img', text)
    assert re.search(r'<td class="words" [^>]*>wavelet', text)
