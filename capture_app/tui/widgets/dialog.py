"""Base class of screens that are pushed over a mode."""

from typing import TypeVar

from textual.app import ComposeResult
from textual.await_complete import AwaitComplete
from textual.screen import Screen
from textual.widget import Widget

Result = TypeVar("Result")


class Dialog(Screen[Result]):
    """Screen pushed over a mode: a question, a form or a whole-screen view. It returns its result once.

    Key presses that arrive after it closes do not reach it.
    """

    def __init__(self, *parts: Widget) -> None:
        super().__init__()
        self._parts = parts

    def compose(self) -> ComposeResult:
        """Yield the dialog's parts."""
        yield from self._parts

    def dismiss(self, result: Result | None = None) -> AwaitComplete:
        """Close and return the result; do nothing unless on top."""
        return super().dismiss(result) if self.is_active else AwaitComplete()
