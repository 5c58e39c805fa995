"""The comparison page in a real browser: it opens, answers and says nothing wrong."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ataa_jax import files
from ataa_jax.report import page
from tests.comparisons import comparison

webdriver: Any = pytest.importorskip("selenium.webdriver", reason="needs selenium")

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="needs chromium and chromedriver on the path"
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator[Any]:
    from selenium.webdriver.chrome.service import Service

    folder = tmp_path_factory.mktemp("page")
    files.write_text(folder / "index.html", page.render(comparison((36, 64), 3)))
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in (
        *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic"),
        *("--no-first-run", "--disable-background-networking", "--disable-sync"),
        *("--disable-component-update", "--window-size=1400,1000"),
        f"--user-data-dir={folder / 'profile'}",
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(executable_path=DRIVER))
    driver.get((folder / "index.html").as_uri())
    yield driver
    driver.quit()


@pytest.fixture(autouse=True)
def afresh(browser) -> Iterator[None]:
    browser.refresh()
    settled(browser)
    yield
    assert browser.get_log("browser") == []


def find(browser: Any, name: str) -> Any:
    return browser.find_element("css selector", f'[data-testid="{name}"]')


def settled(browser: Any, wanted: str = "") -> str:
    """Waits until the stage shows what the controls ask for; returns its pixels."""
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, 20).until(
        lambda b: (
            wanted in (find(b, "stage").get_attribute("data-drawn") or "")
            and find(b, "stage").get_attribute("data-drawn")
        )
    )
    return browser.execute_script(
        "return new Promise((go) => requestAnimationFrame(() => go("
        "document.querySelector('[data-testid=view]').toDataURL())))"
    )


def choose(browser: Any, side: str, method: str) -> None:
    from selenium.webdriver.support.ui import Select

    Select(find(browser, side)).select_by_value(method)


def click(browser: Any, name: str) -> None:
    browser.execute_script("arguments[0].click()", find(browser, name))


def test_it_opens_on_taa_beside_ataa(browser):
    settled(browser, "taa ataa8 2 picture 1")
    assert "picket fence" in browser.title
    assert find(browser, "tag-left").text == "TAA (tuned)"
    assert find(browser, "tag-right").text == "ATAA 8x"


def test_the_divider_moves_by_keyboard(browser):
    from selenium.webdriver.common.keys import Keys

    before = settled(browser)
    slider = find(browser, "slider")
    slider.send_keys(Keys.ARROW_LEFT * 5)
    assert slider.get_attribute("aria-valuenow") == "40"
    slider.send_keys(Keys.END)
    assert slider.get_attribute("aria-valuenow") == "100"
    assert settled(browser) != before


def test_the_divider_moves_by_mouse(browser):
    from selenium.webdriver.common.action_chains import ActionChains

    before = settled(browser)
    view = find(browser, "view")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", view)
    chain = ActionChains(browser).click_and_hold(find(browser, "slider"))
    chain.move_by_offset(-round(view.size["width"] * 0.25), 0).release().perform()
    assert int(find(browser, "slider").get_attribute("aria-valuenow")) in range(23, 28)
    assert settled(browser) != before


def test_another_method_shows_another_picture(browser):
    before = settled(browser)
    choose(browser, "left", "none")
    assert settled(browser, "none ataa8") != before
    assert find(browser, "tag-left").text == "No AA"
    assert "No AA" in find(browser, "facts-left").text


def test_frames_change_by_range_and_by_key(browser):
    from selenium.webdriver.common.keys import Keys

    last = settled(browser, " 2 picture")
    find(browser, "frame").send_keys(Keys.ARROW_LEFT)
    middle = settled(browser, " 1 picture")
    assert middle != last
    assert find(browser, "frame-text").text == "frame 2 of 3"
    browser.find_element("css selector", "body").send_keys(Keys.ARROW_LEFT)
    assert settled(browser, " 0 picture") not in (last, middle)
    browser.find_element("css selector", "body").send_keys(Keys.ARROW_LEFT)
    assert settled(browser, " 2 picture") == last


def test_play_runs_and_stops(browser):
    find(browser, "play").click()
    settled(browser, " 0 picture")
    settled(browser, " 1 picture")
    assert find(browser, "play").get_attribute("aria-pressed") == "true"
    find(browser, "play").click()
    assert find(browser, "play").get_attribute("aria-pressed") == "false"


def test_mask_reasons_and_error_change_the_picture(browser):
    seen = [settled(browser, "picture")]
    for name, kind in (
        ("mask-toggle", "mask"),
        ("show-why", "why"),
        ("show-error", "error"),
    ):
        click(browser, name)
        seen.append(settled(browser, f" {kind} "))
    assert len(set(seen)) == 4
    click(browser, "show-picture")
    assert settled(browser, "picture") == seen[0]


def test_the_mask_has_its_colours_pixel_by_pixel(browser):
    choose(browser, "left", "ataa8")
    click(browser, "mask-toggle")
    settled(browser, "ataa8 ataa8 2 mask")
    # The last columns of the synthetic masks are FXAA: red.
    red, green, blue = browser.execute_script(
        "const v = document.querySelector('[data-testid=view]');"
        "return [...v.getContext('2d').getImageData("
        "v.width - 2, v.height / 2, 1, 1).data].slice(0, 3)"
    )
    assert red > green + 80
    assert red > blue + 80


def test_zoom_enlarges_and_drag_pans(browser):
    from selenium.webdriver.common.action_chains import ActionChains

    whole = settled(browser)
    click(browser, "zoom-4")
    large = settled(browser, " 4")
    assert large != whole
    view = find(browser, "view")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", view)
    width, height = view.size["width"], view.size["height"]
    chain = ActionChains(browser).move_to_element_with_offset(
        view, -round(width / 4), round(height / 4)
    )
    chain.click_and_hold().move_by_offset(90, -60).release().perform()
    assert settled(browser) != large
    assert find(browser, "slider").get_attribute("aria-valuenow") == "50"


def test_swap_exchanges_the_sides(browser):
    find(browser, "swap").click()
    settled(browser, "ataa8 taa ")
    assert find(browser, "tag-left").text == "ATAA 8x"


def test_the_probe_names_pixel_and_technique(browser):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.support.ui import WebDriverWait

    view = find(browser, "view")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", view)
    offset = round(view.size["width"] / 2) - 4
    ActionChains(browser).move_to_element_with_offset(view, offset, 0).perform()
    WebDriverWait(browser, 10).until(lambda b: "FXAA" in find(b, "probe").text)
    assert "no previous position" in find(browser, "probe").text


def test_plots_follow_the_chosen_score(browser):
    from selenium.webdriver.support.ui import Select

    plot = find(browser, "plot-frames")
    before = plot.get_attribute("innerHTML")
    Select(find(browser, "metric")).select_by_value("ataa_share")
    assert plot.get_attribute("innerHTML") != before
    assert len(find(browser, "plot-cost").find_elements("css selector", "circle")) == 7


def test_every_control_has_a_name(browser):
    nameless = browser.execute_script(
        "return [...document.querySelectorAll('select, input, button, [role=slider], "
        "[role=img], img')].filter((e) => !(e.getAttribute('aria-label') || e.alt || "
        "e.closest('label') || e.labels?.length)).map((e) => e.outerHTML)"
    )
    assert nameless == []


def test_it_asks_for_nothing_from_outside(browser):
    loaded = browser.execute_script(
        "return performance.getEntriesByType('resource').map((e) => e.name)"
        ".filter((name) => !name.startsWith('data:'))"
    )
    assert loaded == []


def test_a_narrow_window_does_not_scroll_sideways(browser):
    size = browser.get_window_size()
    browser.set_window_size(520, 900)
    wide, room = browser.execute_script(
        "return [document.documentElement.scrollWidth, window.innerWidth]"
    )
    browser.set_window_size(size["width"], size["height"])
    assert wide <= room


def test_the_test_page_is_small(tmp_path: Path):
    assert len(page.render(comparison((36, 64), 3))) < 1_000_000
