"""Rules of a command: beside which other options an option has an effect; checked before the command runs."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import click
from click.core import ParameterSource


class Rule(NamedTuple):
    """Options, and the alternatives of which one must hold for each of them to have an effect.

    An alternative is an option that is given (`--every`), one with a value (`--from=board|kept`), or the
    opposite of either (`!--stop`); an argument has its parameter's name. Without `options`, the command
    itself needs one of the alternatives.
    """

    options: str
    alternatives: str
    hint: str = ""
    """End of the error: what to do instead."""


class RuledCommand(click.Command):
    """Command that refuses an option which has no effect beside the others.

    If the first alternative is a value of an option that is not given, the command takes that value instead.
    """

    def __init__(self, *args: Any, rules: Sequence[Rule] = (), **settings: Any) -> None:
        super().__init__(*args, **settings)
        self._rules = rules

    @property
    def rules(self) -> Sequence[Rule]:
        """Rules of its options."""
        return self._rules

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse a command line. Raises UsageError for an option without effect."""
        rest = super().parse_args(ctx, args)
        if not ctx.resilient_parsing and self.rules:
            typed = _Typed(ctx)
            for rule, _ in typed.broken(self.rules):
                typed.choose(rule.alternatives.split()[0])
            for rule, name in typed.broken(self.rules):
                raise click.UsageError(typed.sentence(rule, name), ctx)
        return rest


class _Typed:
    """What was typed of a command line, by the names of options and arguments."""

    def __init__(self, ctx: click.Context) -> None:
        self._ctx = ctx
        self._params = {name: param for param in ctx.command.get_params(ctx) for name in param.opts}

    def broken(self, rules: Sequence[Rule]) -> Iterator[tuple[Rule, str]]:
        """Yield each rule that does not hold, with the option that was typed."""
        for rule in rules:
            typed = [name for name in rule.options.split() if self._is_given(name)]
            if (typed or not rule.options) and not any(map(self._holds, rule.alternatives.split())):
                yield rule, "".join(typed[:1])

    def choose(self, alternative: str) -> None:
        """Take the value of an alternative, unless its option is given."""
        name, _, values = alternative.partition("=")
        if values and name in self._params and not self._is_given(name):
            self._ctx.params[self._params[name].name or ""] = values.partition("|")[0]

    def sentence(self, rule: Rule, typed: str) -> str:
        """Return the error of a broken rule."""
        ways = rule.alternatives.split()
        without = _either([self._words(way[1:]) for way in ways if way[0] == "!"])
        beside = _either([self._words(way) for way in ways if way[0] != "!"])
        if not typed:
            return f"give {beside}{rule.hint}"
        if not without:
            return f"{typed} needs {beside}{rule.hint}"
        return f"{typed} does not work with {without}{beside and f', except with {beside}'}{rule.hint}"

    def _is_given(self, name: str) -> bool:
        param = self._params.get(name)
        # Of a flag, its opposite is given, too; a function may be the source of a default.
        return param is not None and self._ctx.get_parameter_source(param.name or "") in (
            ParameterSource.COMMANDLINE,
            ParameterSource.ENVIRONMENT,
        )

    def _holds(self, alternative: str) -> bool:
        name, _, values = alternative.lstrip("!").partition("=")
        param = self._params.get(name)
        value = None if param is None else self._ctx.params.get(param.name or "", True)
        if values:
            holds = any(
                str(each).casefold().removesuffix(".0") in values.split("|")
                for each in (value if isinstance(value, tuple) else (value,))
            )
        else:
            holds = self._is_given(name) and value is not False
        return holds is not alternative.startswith("!")

    def _words(self, alternative: str) -> str:
        name, _, values = alternative.partition("=")
        param = self._params.get(name)
        label = param.human_readable_name if isinstance(param, click.Argument) else name
        return f"{label} {_either(values.split('|'))}".strip()


def _either(words: Sequence[str]) -> str:
    """Return alternatives in words: a, b or c."""
    return " or ".join(part for part in (", ".join(words[:-1]), *words[-1:]) if part)
