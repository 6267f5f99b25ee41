"""Command palette that finds an action by its title, and by other programs' words for it."""

from typing import Any, cast

from textual.command import Hit, Hits
from textual.system_commands import SystemCommandsProvider

from capture_app.console.known_words import words_for

_KNOWN = 50
"""Score of a whole known word: above letters that are scattered over a title."""


class Palette(SystemCommandsProvider):
    """Actions that match what is typed."""

    async def search(self, query: str) -> Hits:
        """Yield the actions of which the title matches, or a word begins so."""
        # A number is asked of cameras, of which an action changes the number.
        query = " ".join(word for word in query.split() if not word.isdecimal()) or "cameras"
        matcher, typed = self.matcher(query), query.strip().casefold().replace(" ", "-")
        for line, (title, text, callback, _) in cast(Any, self.app).actions(self.screen):
            words = words_for(line)
            # Of an action and its choices, as of an export's formats, the choice that is meant comes first.
            known = _KNOWN + len(line) if typed in words else any(word.startswith(typed) for word in words)
            if score := matcher.match(title) + known:
                yield Hit(score, matcher.highlight(title), callback, help=text)
