"""Chromium of the machine, without a window, for tests of pages; skips where it is absent."""

import json
import shutil

import pytest

DARK = [{"name": "prefers-color-scheme", "value": "dark"}]


@pytest.fixture(scope="session")
def chromium():
    """Start a browser that logs its console and its requests, and resolves no name but those of this machine."""
    binary, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if binary is None or driver is None:
        pytest.skip("needs chromium and chromium-driver, as Debian packages them")
    webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium, of the extra test")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--disable-gpu",
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield browser
    browser.quit()


@pytest.fixture
def browser(chromium):
    """Give a test the browser with a wide light screen."""
    screen(chromium, 1280, 900)
    emulate(chromium)
    return chromium


def screen(browser, width, height=900):
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def emulate(browser, media="", features=()):
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": list(features)})


def complaints(browser):
    """Return the messages of the console since they were last asked for."""
    return [entry["message"] for entry in browser.get_log("browser")]


def requested(browser):
    """Return the addresses that were requested since they were last asked for."""
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    return {event["params"]["request"]["url"] for event in events if event["method"] == "Network.requestWillBeSent"}
