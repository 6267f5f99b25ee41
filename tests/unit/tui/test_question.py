"""Questions over the screen."""

import pytest
from textual import events
from textual.app import App
from textual.widgets import OptionList, Static

from capture_app.common.errors import BadInputError
from capture_app.tui.question import Answer, ListQuestion, Question, TextQuestion
from tests.unit.tui.driving import make_app, running, settle
from tests.unit.tui.fake_rig import FakeRig

ANSWERS = (Answer("keep", "k", "Keep both"), Answer("trash", "t", "Trash the earlier one"))


class AskingApp(App[None]):
    def __init__(self, question: Question | TextQuestion) -> None:
        super().__init__()
        self.question = question
        self.answers: list[str | None] = []

    def on_mount(self) -> None:
        self.push_screen(self.question, self.answers.append)


async def test_an_answer_by_its_key_by_enter_and_by_click() -> None:
    for keys, answer in (
        (["t"], "trash"),
        (["enter"], "keep"),
        (["right", "enter"], "trash"),
        (["escape"], None),
    ):
        app = AskingApp(Question("Take it [b]again[/b]?\x1b[31m", ANSWERS, title="Retake [x]"))
        async with app.run_test(size=(80, 24)) as pilot:
            assert (
                str(app.question.query_one(".question", Static).content) == "Take it [b]again[/b]?\\x1b[31m"
            )
            await pilot.press(*keys)
            await pilot.pause()
            assert app.answers == [answer]
    app = AskingApp(Question("Again?", ANSWERS))
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause()
        seen = app.export_screenshot().replace("&#160;", " ")
        assert "k Keep both" in seen
        assert "t Trash the earlier one" in seen
        await pilot.click("#answer-trash")
        await pilot.pause()
        assert app.answers == ["trash"]


async def test_a_key_pressed_twice_gives_one_answer() -> None:
    for key in ("t", "escape"):
        app = AskingApp(Question("Again?", ANSWERS))
        async with app.run_test(size=(80, 24)) as pilot:
            await pilot.pause()
            for _ in range(3):
                app.simulate_key(key)
            await settle(pilot)  # all three have come through, before the app ends
            assert len(app.answers) == 1
            assert app.screen is not app.question


async def test_a_text_is_taken_only_where_nothing_is_wrong_with_it() -> None:
    def check(text: str) -> None:
        if len(text) > 3:
            raise BadInputError("too long")

    app = AskingApp(TextQuestion("Name?", "a", check=check))
    async with app.run_test(size=(80, 24)) as pilot:
        assert "enter accepts" in app.export_screenshot().replace("&#160;", " ")
        await pilot.press("end", "b", "c", "d", "enter")
        await pilot.pause()
        assert app.answers == []
        assert str(app.question.query_one(".wrong", Static).content) == "too long"
        await pilot.press("backspace", "enter")
        await pilot.pause()
        assert app.answers == ["abc"]
    app = AskingApp(TextQuestion("Name?", "kept", check=str))
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("x", "escape")
        await pilot.pause()
        assert app.answers == [None]


async def test_answers_too_long_to_stand_beside_each_other_are_whole_below_each_other() -> None:
    long = tuple(Answer(str(n), str(n), f"This is an answer in many words, number {n}") for n in range(3))
    app = AskingApp(Question("Which?", long))
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause()
        seen = app.export_screenshot().replace("&#160;", " ")
        assert all(f"{answer.key} {answer.label}" in seen for answer in long)
        await pilot.press("down", "enter")
        await pilot.pause()
        assert app.answers == ["1"]


async def test_a_list_of_choices_marks_its_row_without_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    app = make_app(FakeRig(5))
    async with running(app) as pilot:
        app.push_screen(ListQuestion("choose", {"a": ("one", "first"), "b": ("two", "second")}))
        await settle(pilot)
        await pilot.press("down")
        choices = app.screen.query_one(OptionList)
        marked = [
            {bool(part.style and part.style.underline) for part in choices.render_line(y)} for y in (0, 1)
        ]
        assert marked == [{False}, {True}]


async def test_an_explanation_that_its_row_cuts_stands_in_the_border() -> None:
    long = "all that can be said about the second of these choices"
    app = make_app(FakeRig(5))
    async with running(app, 60, 20) as pilot:
        app.push_screen(ListQuestion("choose", {"a": ("one", "first"), "b": ("two", long)}))
        await settle(pilot)
        box = app.screen.query_one("ListQuestion > Vertical")
        assert str(box.border_subtitle) == "enter chooses · esc cancels"
        await pilot.press("down")
        await settle(pilot)
        assert str(box.border_subtitle) == long


async def test_letters_do_not_overtake_the_key_before_them() -> None:
    """A paste by a terminal that knows none, or a slow connection, brings all keys at once."""
    question = TextQuestion("a folder", "/home/ada", check=lambda _: None, title="Import")
    app = AskingApp(question)
    async with app.run_test(size=(80, 24)) as pilot:
        await settle(pilot)
        for key, character in (("ctrl+u", None), *((each, each) for each in "/tmp/none"), ("enter", None)):
            app.post_message(events.Key(key, character))
        await settle(pilot)
        assert app.answers == ["/tmp/none"]


async def test_space_chooses_from_a_list_as_enter_does() -> None:
    for key in ("space", "enter"):
        chosen: list[str | None] = []
        app = make_app(FakeRig(5))
        async with running(app) as pilot:
            rows = {"a": ("one", "first"), "b": ("two", "second")}
            app.push_screen(ListQuestion("choose", rows), chosen.append)
            await settle(pilot)
            await pilot.press("down", key)
            await settle(pilot)
        assert chosen == ["b"]
