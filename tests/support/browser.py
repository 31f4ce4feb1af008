"""Pages in a real browser: what it says of them, and how they look."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chromium-browser"))), None)
LOOK = """<script>addEventListener("load", () => {
  const images = [...document.images], page = document.documentElement;
  parent.postMessage({images: images.length, broken: images.filter(i => !i.complete || !i.naturalWidth).map(i => i.src),
    wide: page.scrollWidth - page.clientWidth}, "*");
})</script></body>"""
DRIVER = """<!doctype html><title></title><iframe id="shown" width="%d" height="900"></iframe><script>
const pages = %s, seen = {};
let at = 0;
addEventListener("message", (event) => {
  if (event.source !== shown.contentWindow || event.data.wide === undefined) return;
  seen[pages[at++]] = event.data;
  if (at < pages.length) shown.src = pages[at]; else document.title = JSON.stringify(seen);
});
shown.src = pages[0];
</script>"""


def require(request: pytest.FixtureRequest) -> None:
    """Skip a test where there is no browser; let it fail there under `--need-browser`."""
    if PROGRAM is None:
        message = "needs Chromium: apt-get install chromium"
        pytest.fail(message) if request.config.getoption("need_browser") else pytest.skip(message)


def chromium(folder: Path, page: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Let the browser load a page by its address; its profile lies in the folder."""
    common = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        f"--user-data-dir={folder / 'profile'}",
    ]
    return subprocess.run(
        [str(PROGRAM), *common, "--enable-logging=stderr", *options, page],
        capture_output=True, text=True, timeout=180, env={**os.environ, "HOME": str(folder)},
    )  # fmt: skip


def complaints(done: subprocess.CompletedProcess[str]) -> list[str]:
    """Return what pages wrote on the console, errors of scripts included."""
    return [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def look(site: Path, pages: Sequence[str], width: int, folder: Path) -> dict[str, Any]:
    """Return of each page of a site, by its path there, the number of `images`, those `broken`, and by how many pixels it is
    too `wide` for a window of this width.

    Asserts that nothing is written on the console. The pages are changed: they report to the one that shows them.
    """
    for page in pages:
        text = (site / page).read_text(encoding="utf-8")
        if LOOK not in text:
            (site / page).write_text(text.replace("</body>", LOOK), encoding="utf-8")
    driver = site / f"look_{width}.html"
    driver.write_text(DRIVER % (width, json.dumps(list(pages))), encoding="utf-8")
    done = chromium(
        folder, driver.as_uri(), f"--window-size={width + 100},1000", "--virtual-time-budget=120000", "--dump-dom"
    )
    driver.unlink()
    found = re.search(r"<title>({.*?})</title>", done.stdout)
    assert found, done.stderr[-3000:]
    assert not complaints(done)
    return json.loads(found[1])


def screenshot(page: Path, width: int, height: int, to: Path, folder: Path) -> None:
    """Write a picture of what the browser shows of a page."""
    to.parent.mkdir(parents=True, exist_ok=True)
    chromium(
        folder, page.as_uri(), f"--window-size={width},{height}", "--virtual-time-budget=5000", f"--screenshot={to}"
    )
