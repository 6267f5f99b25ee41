"""What is pushed over a mode and closes once: a question, a form, a view of the whole screen."""

from typing import TypeVar

from textual.await_complete import AwaitComplete
from textual.screen import Screen

Result = TypeVar("Result")


class Dialog(Screen[Result]):
    """Gives its result once: keys that are still on their way when it closes are not its own any more."""

    def dismiss(self, result: Result | None = None) -> AwaitComplete:
        """Close and give the result; nothing where it is not on top."""
        return super().dismiss(result) if self.is_active else AwaitComplete()
