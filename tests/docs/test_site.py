"""The site: it builds without a warning, and a browser shows it without an error, with all pictures, and finds words in it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import browser

ROOT = Path(__file__).parents[2]
SCREENSHOTS = ROOT / "build" / "screenshots"


@pytest.fixture(scope="module")
def site(tmp_path_factory, request) -> Path:
    """The site, built anew; tutorials that `make docs` ran and that have not changed since do not run again."""
    mkdocs = shutil.which("mkdocs", path=str(Path(sys.executable).parent))
    if mkdocs is None:
        message = "needs mkdocs: make docs"
        pytest.fail(message) if request.config.getoption("need_browser") else pytest.skip(message)
    folder = tmp_path_factory.mktemp("site") / "site"
    command = [str(mkdocs), "build", "--strict", "-f", str(ROOT / ".mkdocs.yml"), "--site-dir", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0 and "WARNING" not in done.stderr, done.stderr
    return folder


def pages(site: Path) -> list[str]:
    return sorted(str(page.relative_to(site)) for page in site.rglob("*.html") if page.name != "404.html")


@pytest.mark.browser
def test_the_site_has_all_pages_and_asks_no_other_server_for_anything(site):
    theory = (site / "theory.html").read_text(encoding="utf-8")
    assert theory.count("<math") > 100 and "arithmatex" not in theory
    found = pages(site)
    tutorials = [f"tutorials/{path.stem}.html" for path in (ROOT / "docs" / "tutorials").glob("*.py")]
    assert {"index.html", "api.html", "extend.html", "scene.html", "gallery.html", *tutorials} <= set(found)
    for page in found:
        text = (site / page).read_text(encoding="utf-8")
        assert not re.search(r'<(?:script|img|iframe|source)[^>]+src="?(?:https?:)?//', text), page
        assert not re.search(r'<link[^>]+rel="?(?:stylesheet|preconnect|icon)[^>]+href="?https?://', text), page
    shown = (site / "tutorials" / "bunch.html").read_text(encoding="utf-8")
    assert shown.count("<img") == 3 and "step 10: rms size" in shown  # results, not code alone


@pytest.mark.browser
@pytest.mark.parametrize("width", [500, 1200])
def test_a_browser_shows_every_page_with_its_pictures(site, tmp_path, request, width):
    browser.require(request)
    seen = browser.look(site, pages(site), width, tmp_path)
    assert list(seen) == pages(site)
    assert {page: one["broken"] for page, one in seen.items() if one["broken"]} == {}
    assert {page: one["wide"] for page, one in seen.items() if one["wide"] > 0} == {}
    examples = sum(example.is_file() for example in (ROOT / "examples").iterdir())
    assert seen["gallery.html"]["images"] == examples
    for page in ("index", "gallery", "tutorials/bunch"):
        picture = SCREENSHOTS / f"{page.replace('/', '_')}_{width}.png"
        picture.unlink(missing_ok=True)
        browser.screenshot(site / f"{page}.html", width, 900, picture, tmp_path)
        assert picture.stat().st_size > 20_000


@pytest.mark.browser
def test_the_search_finds_words_in_a_folder_without_a_server(site, tmp_path, request):
    browser.require(request)
    address = (site / "index.html").as_uri() + "?q=emittance"
    done = browser.chromium(tmp_path, address, "--virtual-time-budget=10000", "--dump-dom")
    assert not browser.complaints(done)
    found = re.search(r'md-search-result__meta">\s*(\d+) matching', done.stdout)
    assert found and int(found[1]) >= 5, done.stdout[:500]
    assert 'href="diagnostics.html' in done.stdout.split("md-search-result__list")[1]
