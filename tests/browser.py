"""A Chromium of this computer, driven by Playwright; nothing is downloaded. Tests are skipped, with the reason, where there is none."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from typing import Literal

import pytest
from playwright.sync_api import Browser, Error, Page, sync_playwright

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
OPTIONS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
PATIENCE = 120_000.0
"""Milliseconds after which something is wrong, however busy the computer is."""


@contextmanager
def chromium() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("there is no Chromium on this computer")
    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(OPTIONS), timeout=PATIENCE)
        except Error as error:
            pytest.skip(f"the browser does not start here: {error.message.splitlines()[0]}")
        yield browser
        browser.close()


@contextmanager
def opened(
    browser: Browser, address: str, scheme: Literal["light", "dark"] = "light", width: int = 1200
) -> Iterator[Page]:
    """A page at this address. Fails at its end if the console shows anything or if a request leaves `address`."""
    own = address.partition("#")[0].rpartition("/")[0]
    faults: list[str] = []
    context = browser.new_context(color_scheme=scheme, viewport={"width": width, "height": 900})
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    page.on("console", lambda message: faults.append(f"console: {message.text}"))
    page.on("pageerror", lambda error: faults.append(f"error: {error}"))
    page.on("dialog", lambda dialog: faults.append(f"dialog: {dialog.message}"))
    page.on(
        "request",
        lambda request: None if request.url.startswith((own, "data:")) else faults.append(f"request: {request.url}"),
    )
    page.goto(address)
    yield page
    context.close()
    assert faults == []


def violations(page: Page) -> list[str]:
    """What axe-core finds wrong with the page as it is now."""
    page.evaluate(files("axe_playwright_python").joinpath("axe.min.js").read_text(encoding="utf-8"))
    found = page.evaluate("axe.run({preload: false})")
    return [f"{one['id']}: {node['html']}" for one in found["violations"] for node in one["nodes"]]


def overhang(page: Page) -> int:
    """Pixels by which the page is wider than the window."""
    wider: int = page.evaluate("document.documentElement.scrollWidth - innerWidth")
    return wider
