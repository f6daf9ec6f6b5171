"""The live page in a browser: what it shows, its buttons and prompts, hostile texts, and its accessibility."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from running_run import HOSTILE, QUESTION, RunningRun, close_all

from planrunner.archive.live import LiveNotice, take_answer
from planrunner.archive.pausing import asked_to_pause
from planrunner.live.monitor import Monitor
from planrunner.live.server import LiveServer
from tests.browser import chromium, opened, overhang, violations

pytestmark = pytest.mark.slow
expect.set_options(timeout=120_000)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture
def served(tmp_path: Path) -> Iterator[LiveServer]:
    with LiveServer(Monitor(tmp_path)) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()
            close_all()


def test_a_run_is_shown_while_it_goes_on_and_when_it_has_ended(
    browser: Browser, served: LiveServer, tmp_path: Path
) -> None:
    with opened(browser, served.address) as page:
        expect(page.get_by_text("No run is in progress.")).to_be_visible()
        run = RunningRun(tmp_path)
        card = page.get_by_role("article", name="drift, device FG-7")
        expect(card).to_contain_text("Segment 3 of 8: P3")
        expect(card).to_contain_text("25 %, about 2 min left")
        row = card.get_by_role("row").filter(has=page.get_by_role("rowheader", name="rate_x"))
        assert row.get_by_role("cell").all_inner_texts() == ["1000", "0.001", "0.02", "-0.06", "0.07", "deg/s"]
        expect(card.locator("canvas")).to_have_count(2)
        run.show(index=3, label="P4", notices=(LiveNotice("2026-03-01T12:00:00+00:00", "table: retried"),))
        expect(card).to_contain_text("Segment 4 of 8: P4")
        expect(card).to_contain_text("12:00:00 UTC: table: retried")
        run.end()
        expect(card).to_have_count(0)
        expect(page.get_by_role("row").filter(has_text=run.path.name)).to_contain_text("finished")
        assert page.url == served.address.partition("#")[0]  # the token is not kept in the history
        page.reload()
        expect(page.get_by_text("Connected")).to_be_visible()


def test_a_run_is_paused_and_continued(browser: Browser, served: LiveServer, tmp_path: Path) -> None:
    run = RunningRun(tmp_path)
    with opened(browser, served.address) as page:
        page.get_by_role("button", name="Pause after this segment").click()
        expect(page.get_by_text("pauses after this segment")).to_be_visible()
        assert asked_to_pause(run.writer.folder)
        run.show(paused=True, activity="paused in the safe state")
        page.get_by_role("button", name="Continue").click()
        expect(page.get_by_role("button", name="Pause after this segment")).to_be_visible()
        assert not asked_to_pause(run.writer.folder)


def test_a_prompt_is_answered_with_the_keyboard_alone(browser: Browser, served: LiveServer, tmp_path: Path) -> None:
    run = RunningRun(tmp_path)
    with opened(browser, served.address) as page:
        expect(page.get_by_role("article")).to_be_visible()
        run.show(question=QUESTION)
        prompt = page.get_by_role("alert").filter(has_text="The run waits for you")
        expect(prompt).to_contain_text("Mount face B")
        expect(page).to_have_title("(1 waiting) planrunner: 1 running")
        for _ in range(20):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement.tagName") == "INPUT":
                break
        page.keyboard.type("Li Wei")
        with page.expect_response("**/api/answer"):
            page.keyboard.press("Enter")
        answer = take_answer(run.writer.folder, QUESTION.id)
        assert answer is not None and answer.by == "Li Wei"
        run.show()
        expect(prompt).to_have_count(0)


def test_hostile_texts_are_shown_as_they_are(browser: Browser, served: LiveServer, tmp_path: Path) -> None:
    run = RunningRun(tmp_path, device=HOSTILE)
    run.show(
        question=QUESTION, label=HOSTILE, activity=HOSTILE, notices=(LiveNotice("2026-03-01T12:00:00+00:00", HOSTILE),)
    )
    with opened(browser, served.address) as page:
        card = page.get_by_role("article")
        expect(card).to_contain_text("<img src=x onerror=")
        expect(card.locator("img, script, b")).to_have_count(0)
        assert "planrunner" in page.title()
        run.end()
        expect(page.locator("#recent")).to_contain_text("<img src=x onerror=")


@pytest.mark.parametrize(("scheme", "width"), [("light", 1200), ("dark", 1200), ("light", 380), ("dark", 380)])
def test_the_page_is_accessible_and_nothing_sticks_out(
    browser: Browser, served: LiveServer, tmp_path: Path, scheme: str, width: int
) -> None:
    RunningRun(tmp_path).end()
    run = RunningRun(tmp_path, device="D" * 90)
    run.show(question=QUESTION, notices=(LiveNotice("2026-03-01T12:00:00+00:00", "table: retried"),))
    with opened(browser, served.address, "dark" if scheme == "dark" else "light", width) as page:
        expect(page.locator("canvas").first).to_be_visible()
        assert violations(page) == [] and overhang(page) <= 0


def test_a_wrong_address_says_what_to_do(browser: Browser, served: LiveServer) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto(f"{served.address}x")
    expect(page.get_by_text("open the page with the address that `planrunner serve` has printed")).to_be_visible()
    context.close()
