"""Field for a line of text."""

from textual import events
from textual.widgets import Input


class TextField(Input):
    """Input that does its keys in the order in which they are typed.

    Textual's hands the key of a binding, such as ctrl+u, to the app, and letters typed at once overtake it.
    """

    async def _on_key(self, event: events.Key) -> None:
        for binding in self._bindings.key_to_bindings.get(event.key, ()):
            if await self.app.run_action(binding.action, self):
                event.stop()
                event.prevent_default()
                return
