"""The study's page in a real browser: keyboard, mouse, going back, resuming, a server that fails."""

from __future__ import annotations

import io
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from services.db.engine import Database
from services.db.migrate import upgrade
from services.web.study_create import PictureFile, StudyEntry, create_study, list_studies
from services.web.study_store import StudyStore

pytestmark = pytest.mark.browser
QUESTIONS = 8


def picture(grey: int) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.full((64, 64), grey, np.uint8)).save(stream, format="PNG")
    return stream.getvalue()


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no Chromium here: scripts/system-packages.sh chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[str, StudyStore]]:
    import uvicorn

    from services.web.study_app import create_study_app

    database = Database(f"sqlite:///{tmp_path / 'study.db'}")
    upgrade(database)
    entries = [
        StudyEntry(
            f"f{k}", None, tuple(PictureFile(0, s, "image/png", picture(40 * k + 20)) for s in ("hanging", "stretch"))
        )
        for k in range(4)
    ]
    store = create_study(database, "Pilot study", entries, triplets=QUESTIONS, shared=0, seed=1)
    server = uvicorn.Server(uvicorn.Config(create_study_app(store), port=0, log_level="error"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        thread.join(0.02)
    port = server.servers[0].sockets[0].getsockname()[1]
    yield f"http://127.0.0.1:{port}/", store
    server.should_exit = True
    thread.join(10)
    database.close()


@pytest.fixture
def page(chromium: Any, served: tuple[str, StudyStore]) -> Iterator[Any]:
    context = chromium.new_context()
    page = context.new_page()
    page.set_default_timeout(15_000)
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(served[0])
    yield page
    context.close()
    assert problems == []


def begin(page: Any) -> None:
    page.select_option("#experience", "some")
    page.click("#begin button")
    expect_question(page, 1)


def expect_question(page: Any, number: int) -> None:
    page.wait_for_function(
        "text => !document.getElementById('question').hidden && document.getElementById('count').textContent === text",
        arg=f"{number} of {QUESTIONS}",
    )


def test_the_whole_study_by_keyboard(page: Any, served: tuple[str, StudyStore]) -> None:
    page.wait_for_function("document.title === 'Pilot study'")  # set once the page has asked the server for the study
    begin(page)
    assert page.eval_on_selector_all("#question img", "images => images.every(i => i.naturalWidth === 64)")
    assert page.eval_on_selector_all("#question img", "images => images.length") == 6
    for number in range(1, QUESTIONS + 1):
        expect_question(page, number)
        page.keyboard.press("ArrowLeft" if number % 2 else "ArrowRight")
    page.wait_for_selector("#thanks:not([hidden])")
    exported = served[1].export()
    assert len(exported) == QUESTIONS
    assert [e.chosen == e.left for e in exported] == [number % 2 == 1 for number in range(1, QUESTIONS + 1)]
    assert all(e.experience == "some" and e.milliseconds >= 0 for e in exported)


def test_by_mouse_and_back_again(page: Any, served: tuple[str, StudyStore]) -> None:
    begin(page)
    page.click("#left")
    expect_question(page, 2)
    page.keyboard.press("Backspace")
    expect_question(page, 1)
    assert page.get_attribute("#left", "aria-pressed") == "true"
    page.click("#right")
    expect_question(page, 2)
    page.click("#back")
    expect_question(page, 1)
    assert page.get_attribute("#right", "aria-pressed") == "true"
    (exported,) = served[1].export()
    assert exported.chosen == exported.right
    assert exported.changes == 1


def test_buttons_are_reached_with_the_tab_key(page: Any, served: tuple[str, StudyStore]) -> None:
    begin(page)
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.id") == "right"
    page.keyboard.press("Enter")
    expect_question(page, 2)
    (exported,) = served[1].export()
    assert exported.chosen == exported.right


def test_a_key_held_down_answers_once(page: Any, served: tuple[str, StudyStore]) -> None:
    begin(page)
    page.evaluate(
        """for (let i = 0; i < 5; i++)
             document.dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowLeft", repeat: i > 0, bubbles: true}))"""
    )
    expect_question(page, 2)
    assert len(served[1].export()) == 1


def test_the_address_resumes(page: Any, chromium: Any, served: tuple[str, StudyStore]) -> None:
    begin(page)
    page.keyboard.press("ArrowLeft")
    expect_question(page, 2)
    address = page.url
    assert "#part_" in address
    other = chromium.new_context().new_page()
    other.goto(address)
    expect_question(other, 2)
    other.keyboard.press("ArrowRight")
    expect_question(other, 3)
    other.context.close()
    page.reload()
    expect_question(page, 3)
    assert len(served[1].export()) == 2


def test_a_failing_server_is_said_and_nothing_is_lost(page: Any, served: tuple[str, StudyStore]) -> None:
    begin(page)
    page.route("**/answers/*", lambda route: route.fulfill(status=503, body="{}"))
    page.keyboard.press("ArrowLeft")
    page.wait_for_selector("#trouble:not([hidden])")
    assert "503" in page.inner_text("#trouble")
    page.unroute("**/answers/*")
    page.keyboard.press("ArrowLeft")
    expect_question(page, 2)
    assert page.is_hidden("#trouble")
    assert len(served[1].export()) == 1


def test_a_picture_that_fails_leaves_the_question_as_it_was(page: Any, served: tuple[str, StudyStore]) -> None:
    begin(page)
    shown = page.eval_on_selector_all("#question img", "images => images.map(i => i.src)")
    seen = [0]

    def fail_the_last(route: Any) -> None:
        seen[0] += 1
        if seen[0] == 6:
            route.abort()
        else:
            route.continue_()

    page.route("**/pictures/*", fail_the_last)
    page.keyboard.press("ArrowLeft")
    page.wait_for_selector("#trouble:not([hidden])")
    assert page.eval_on_selector_all("#question img", "images => images.map(i => i.src)") == shown
    assert page.inner_text("#count") == f"1 of {QUESTIONS}"
    page.unroute("**/pictures/*")
    page.keyboard.press("ArrowLeft")
    expect_question(page, 2)
    (exported,) = served[1].export()
    assert exported.position == 0 and exported.chosen == exported.left and exported.changes == 0


def test_another_participants_address_shows_nothing_of_this_ones(page: Any, served: tuple[str, StudyStore]) -> None:
    begin(page)
    page.keyboard.press("ArrowLeft")
    expect_question(page, 2)
    other = served[1].add_participant(simulated=False).id
    page.route("**/questions/*", lambda route: route.fulfill(status=503, body="{}"))
    page.evaluate("id => { location.hash = id; }", other)
    page.wait_for_selector("#trouble:not([hidden])")
    assert page.is_hidden("#question")
    page.keyboard.press("ArrowLeft")
    page.unroute("**/questions/*")
    page.reload()
    expect_question(page, 1)
    assert len(served[1].export()) == 1


def test_a_page_that_was_open_for_days_answers(page: Any, served: tuple[str, StudyStore]) -> None:
    begin(page)
    page.evaluate("() => { const now = performance.now(); performance.now = () => now + 3 * 86400000; }")
    page.keyboard.press("ArrowLeft")
    expect_question(page, 2)
    (exported,) = served[1].export()
    assert exported.milliseconds == 86_400_000


@pytest.mark.parametrize("added", ["%20", "\u201d", "/", "?utm=1"])
def test_what_a_mail_adds_to_an_address_is_passed_over(page: Any, added: str) -> None:
    begin(page)
    page.keyboard.press("ArrowLeft")
    expect_question(page, 2)
    address = page.url
    page.goto("about:blank")
    page.goto(address + added)
    expect_question(page, 2)


@pytest.mark.parametrize("nobody", ["part_0", "part_" + 32 * "0", "x" * 90])
def test_an_address_of_nobody(page: Any, served: tuple[str, StudyStore], nobody: str) -> None:
    page.goto("about:blank")
    page.goto(f"{served[0]}#{nobody}")
    page.wait_for_selector("#trouble:not([hidden])")
    assert "no participant" in page.inner_text("#trouble")
    assert page.is_visible("#welcome") and page.inner_text("#study-name") == "Pilot study"


def test_a_beginning_that_fails_is_tried_again(page: Any, served: tuple[str, StudyStore]) -> None:
    """Nobody begins twice; a page that came to nothing has a button; an identifier of nobody is dropped."""
    fail = "() => document.getElementById('trouble').hidden === false"
    page.route("**/participants/part_*", lambda route: route.fulfill(status=503, body="{}"))
    page.click("#begin button")
    page.wait_for_function(fail)
    address = page.url
    page.unroute("**/participants/part_*")
    page.click("#begin button")
    expect_question(page, 1)
    assert page.url == address and list_studies(served[1].database)[0]["begun"] == 1

    passing = [(503, "{}"), (404, "<p>no such page</p>")]  # the second is a proxy's
    page.route("**/participants/part_*", lambda route: route.fulfill(status=passing[0][0], body=passing.pop(0)[1]))
    page.reload()
    for status in (503, 404):
        page.wait_for_function(fail)
        assert str(status) in page.inner_text("#trouble") and page.is_hidden("#welcome") and page.url == address
        if not passing:
            page.unroute("**/participants/part_*")
        page.click("#again")
    expect_question(page, 1)
    assert page.is_hidden("#again")

    page.goto(served[0] + "#part_0")
    page.wait_for_selector("#welcome:not([hidden])")
    page.wait_for_function(fail)
    assert "no participant" in page.inner_text("#trouble") and page.is_hidden("#again")
    assert page.url == served[0]
    begin(page)
    assert list_studies(served[1].database)[0]["begun"] == 2


def test_a_double_click_answers_once(page: Any, served: tuple[str, StudyStore]) -> None:
    """The next question is there before the second click: it is not a vote on that."""
    begin(page)
    page.evaluate(
        """async (second) => {
             const left = document.getElementById("left");
             const click = (detail) => left.dispatchEvent(new MouseEvent("click", {detail, bubbles: true}));
             click(1);
             while (document.getElementById("count").textContent !== second) await new Promise(requestAnimationFrame);
             await new Promise(requestAnimationFrame);
             click(2);
           }""",
        f"2 of {QUESTIONS}",
    )
    page.wait_for_timeout(600)
    expect_question(page, 2)
    assert len(served[1].export()) == 1
