"""The page of a screen's panel in a real browser, where there is one; refreshes come as the test says."""

import json
from pathlib import Path

import pytest

from tests.browser import CHROMIUM, Browser
from tests.unit.companions.panel.screen.test_page import (
    browser,  # noqa: F401 - a fixture
    page,  # noqa: F401 - a fixture
)

pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")]


def test_the_page_asks_for_nothing_and_runs_nothing_else(browser: Browser, page: Path) -> None:
    browser.open(page)
    browser.complaints.clear()
    browser.ask(
        "const script = document.createElement('script');"
        "script.textContent = 'window.stray = 1'; document.body.append(script)"
    )
    assert browser.ask("window.stray === undefined")
    assert browser.complaints, "the policy has refused it"
    browser.complaints.clear()
    browser.ask("document.getElementById('help').click()")
    assert "Each refresh" in browser.ask("document.querySelector('dialog[open]').textContent")
    browser.ask("document.querySelector('dialog button').click()")
    assert not browser.ask("document.querySelector('dialog').open")
    assert browser.complaints == []
    text = page.read_text()
    assert "http:" not in text
    assert "https:" not in text
    json.loads(text.partition('id="panels">')[2].partition("</script>")[0])
