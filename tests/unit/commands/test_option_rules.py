"""Every option has an effect, or is refused with the way in which it has one: each rule, and each option."""

from collections.abc import Iterator

import click
import pytest

from capture_app.console.option_rules import Rule, RuledCommand
from tests.command_lines import every_command

COMMANDS = {
    typed: command
    for typed, command in every_command()
    if isinstance(command, RuledCommand) and not command.hidden
}
RULES = [(typed, rule) for typed, command in COMMANDS.items() for rule in command.rules]
SAMPLES = {
    "--condition": "66",
    "--dictionary": "none",
    "--mark": "cam0=1,2,3,4",
    "--time-shift-ms": "cam0=1",
    "--board": "9x6",
    "--from": "kept",
    "--shard": "1/2",
    "--pair": "cam0,cam1",
    "--camera": "sim",
}
"""Values of options whose type does not say which ones it takes."""


def names_of(typed: str) -> dict[str, click.Parameter]:
    command = COMMANDS[typed]
    return {name: param for param in command.get_params(click.Context(command)) for name in param.opts}


def words_of(typed: str, alternative: str) -> list[str]:
    """What one types for an alternative of a rule, or for an option."""
    name, _, values = alternative.lstrip("!").partition("=")
    param = names_of(typed)[name]
    if isinstance(param, click.Option) and param.is_flag:
        return [name]
    kind = param.type
    value = values.partition("|")[0] or SAMPLES.get(name, "1")
    if not values and isinstance(kind, click.Choice):
        value = str(kind.choices[0])
    elif not values and isinstance(kind, click.FloatRange | click.IntRange):
        value = str(kind.max if kind.max is not None else 5)
    return [value] if isinstance(param, click.Argument) else [name, value]


def parse_words(typed: str, alternatives: list[str]) -> click.Context:
    """Read a command line of these alternatives, with the arguments and options that it requires."""
    missing = [
        name
        for name, param in names_of(typed).items()
        if param.required and name not in {way.lstrip("!").partition("=")[0] for way in alternatives}
    ]
    words = [word for way in dict.fromkeys([*alternatives, *missing]) for word in words_of(typed, way)]
    return COMMANDS[typed].make_context(typed, words)


def needed_by(typed: str, alternatives: list[str]) -> list[str]:
    """Return alternatives with those that their own rules need."""
    for _ in range(4):
        names = {way.partition("=")[0] for way in alternatives}
        for rule in COMMANDS[typed].rules:
            ways = rule.alternatives.split()
            is_asked = not rule.options or names & set(rule.options.split())
            if (
                is_asked
                and all(way[0] != "!" for way in ways)
                and not names & {w.partition("=")[0] for w in ways}
            ):
                alternatives = [*alternatives, ways[0]]
                break
    return alternatives


def pairs(*, negated: bool) -> Iterator[tuple[str, Rule, str, str]]:
    for typed, rule in RULES:
        for option in rule.options.split():
            for way in rule.alternatives.split():
                if way.startswith("!") is negated:
                    yield typed, rule, option, way


@pytest.mark.parametrize(("typed", "rule", "option", "way"), pairs(negated=False))
def test_an_option_is_taken_in_each_way_in_which_it_has_an_effect(
    typed: str, rule: Rule, option: str, way: str
) -> None:
    parse_words(typed, needed_by(typed, [option, way]))


@pytest.mark.parametrize(("typed", "rule", "option", "way"), pairs(negated=True))
def test_an_option_is_refused_beside_one_that_leaves_it_without_effect(
    typed: str, rule: Rule, option: str, way: str
) -> None:
    with pytest.raises(click.UsageError) as refused:
        parse_words(typed, needed_by(typed, [option, way]))
    assert f"{option} does not work with " in refused.value.message or "needs" in refused.value.message


@pytest.mark.parametrize(
    ("typed", "rule", "option"),
    [
        (typed, rule, option)
        for typed, rule in RULES
        for option in rule.options.split()
        if "!" not in rule.alternatives
    ],
)
def test_an_option_alone_chooses_its_way_or_is_refused_with_it(typed: str, rule: Rule, option: str) -> None:
    ways = [way.partition("=") for way in rule.alternatives.split()]
    said, params = "", {}
    try:
        params = parse_words(typed, [option]).params
    except click.UsageError as error:
        said = error.message
    chosen = {name: str(params.get(names_of(typed)[name].name or "")) for name, _, _ in ways}
    assert any(name in said or chosen[name] in values.split("|") for name, _, values in ways), said


@pytest.mark.parametrize(
    ("typed", "rule", "option"),
    [
        (typed, rule, option)
        for typed, rule in RULES
        for option in rule.options.split()
        if "=" in rule.alternatives and "!" not in rule.alternatives
    ],
)
def test_an_option_is_refused_beside_each_other_value_of_the_one_that_decides(
    typed: str, rule: Rule, option: str
) -> None:
    name, _, values = rule.alternatives.split()[0].partition("=")
    param = names_of(typed)[name]
    known = param.type.choices if isinstance(param.type, click.Choice) else (param.metavar or "").split("|")
    others = [str(value) for value in known if str(value) not in values.split("|")]
    assert others
    for value in others:
        with pytest.raises(click.UsageError, match=f"{option} needs .*{name} "):
            parse_words(typed, needed_by(typed, [option, f"{name}={value}"]))


@pytest.mark.parametrize("typed", COMMANDS)
def test_every_rule_names_options_of_its_command(typed: str) -> None:
    named = {
        way.lstrip("!").partition("=")[0]
        for rule in COMMANDS[typed].rules
        for way in (*rule.options.split(), *rule.alternatives.split())
    }
    assert named <= set(names_of(typed))
