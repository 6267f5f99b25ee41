"""Rules of a command: beside which other options an option has an effect; checked before the command runs."""

from collections.abc import Mapping, Sequence
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
        self.rules = rules

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse a command line. Raises UsageError for an option without effect."""
        rest = super().parse_args(ctx, args)
        named = {name: param for param in self.get_params(ctx) for name in param.opts}
        # A rule that may choose a value stands before the others about this value.
        for rule in () if ctx.resilient_parsing else self.rules:
            typed = [name for name in rule.options.split() if _is_given(ctx, named.get(name))]
            alternatives = rule.alternatives.split()
            if (typed or not rule.options) and not any(
                _holds(ctx, named, alternative) for alternative in alternatives
            ):
                name, _, values = alternatives[0].partition("=")
                if not values or name[0] == "!" or _is_given(ctx, named.get(name)):
                    raise click.UsageError(_sentence(rule, "".join(typed[:1])), ctx)
                ctx.params[named[name].name or ""] = values.partition("|")[0]
        return rest


def _is_given(ctx: click.Context, param: click.Parameter | None) -> bool:
    return param is not None and ctx.get_parameter_source(param.name or "") is ParameterSource.COMMANDLINE


def _holds(ctx: click.Context, named: Mapping[str, click.Parameter], alternative: str) -> bool:
    name, _, values = alternative.lstrip("!").partition("=")
    value = ctx.params.get(getattr(named.get(name), "name", ""), True)
    texts = {str(item).casefold().removesuffix(".0") for item in (value if type(value) is tuple else [value])}
    return (
        not texts.isdisjoint(values.split("|"))
        if values
        else _is_given(ctx, named.get(name)) and value is not False
    ) is not alternative.startswith("!")


def _sentence(rule: Rule, typed: str) -> str:
    """Return the error of a broken rule, of which the option `typed` was given."""
    alternatives = rule.alternatives.split()
    without = _either([_words(alternative[1:]) for alternative in alternatives if alternative[0] == "!"])
    beside = _either([_words(alternative) for alternative in alternatives if alternative[0] != "!"])
    needs = f"{typed} needs {beside}" if typed else f"give {beside}"
    refuses = f"{typed} does not work with {without}{beside and f', except with {beside}'}"
    return f"{refuses if without else needs}{rule.hint}"


def _words(alternative: str) -> str:
    name, _, values = alternative.partition("=")
    return f"{name if name[0] == '-' else name.upper()} {_either(values.split('|'))}".strip()


def _either(words: Sequence[str]) -> str:
    """Return alternatives in words: a, b or c."""
    return " or ".join(part for part in (", ".join(words[:-1]), *words[-1:]) if part)
