"""The site of the documentation, read from disk: its search works, and nothing in it comes from the network."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from selenium.webdriver.support.ui import WebDriverWait
from support.reported import PATIENCE_S, chromium

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site") / "site"
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", out]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"})
    assert done.returncode == 0, done.stderr  # with --quiet, warnings would pass
    return out


@pytest.mark.slow
def test_the_search_finds_the_page_about_range_resolution_first(site: Path) -> None:
    with chromium() as browser:
        browser.get((site / "explanation" / "how-it-works.html").as_uri())
        drawing = browser.find_element("css selector", "img[src='how-it-works.svg']")
        assert browser.execute_script("return arguments[0].naturalWidth", drawing) > 0
        browser.execute_script("document.querySelector('#__search').click()")
        browser.find_element("css selector", "input.md-search__input").send_keys("range resolution")
        first = "return document.querySelector('.md-search-result__item h1')?.textContent"  # the words are typed one by one
        WebDriverWait(browser, PATIENCE_S).until(
            lambda shown: shown.execute_script(first) == "Use odometry and other sensors"
        )


@pytest.mark.slow
def test_no_two_pages_of_the_menu_have_one_name_and_no_equation_is_left_as_text(site: Path) -> None:
    start = (site / "index.html").read_text()
    menu = re.findall(r'<a href="[^"#]+" class="md-nav__link">\s*<span class="md-ellipsis">\s*([^<]+?)\s*<', start)
    assert len(menu) > 20 and len(set(menu)) == len(menu)
    for page in (site / "notebooks").glob("*.html"):
        assert not re.search(r"<p>[^<]*\$[^$<]+\$", page.read_text()), page.name


@pytest.mark.slow
def test_every_link_and_picture_of_the_site_leads_to_a_file(site: Path) -> None:
    broken = []
    for page in site.rglob("*.html"):
        for target in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text()):
            if not re.match(r"[a-z]+:|//", target) and page.name != "404.html" and not (page.parent / target).exists():
                broken.append(f"{page.relative_to(site)}: {target}")
    assert broken == []
