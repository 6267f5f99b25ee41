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
ALL_COMMANDS = {typed: command for typed, command in every_command() if not command.hidden}
EVERYWHERE = {"--help", "-h", "--quiet", "-q", "--verbose", "-v", "--json", "--version", "--leader"}
"""Options that are the same in all commands."""
RULES = [
    (typed, rule)
    for typed, command in COMMANDS.items()
    if command.get_params(click.Context(command))  # those of studies come with their options
    for rule in command.rules
]
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
    "--multiview-width": "640",
    "--panorama-pair": "cam0,cam1",
    "--stereo-pair": "cam0,cam1",
    "--serve": "127.0.0.1:1",
    "--connect": "127.0.0.1:1",
    "--listen": "127.0.0.1:1",
    "--leader": "127.0.0.1:1",
    "values": "gain=2",
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
        value = str(kind.max if kind.max is not None else max(5, kind.min or 0))
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
        names = {way.lstrip("!").partition("=")[0] for way in alternatives}
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


@pytest.mark.parametrize(("typed", "rule", "option", "way"), list(pairs(negated=False)))
def test_an_option_is_taken_in_each_way_in_which_it_has_an_effect(
    typed: str, rule: Rule, option: str, way: str
) -> None:
    parse_words(typed, needed_by(typed, [option, way]))


@pytest.mark.parametrize(("typed", "rule", "option", "way"), list(pairs(negated=True)))
def test_an_option_is_refused_beside_one_that_leaves_it_without_effect(
    typed: str, rule: Rule, option: str, way: str
) -> None:
    with pytest.raises(click.UsageError) as refused:
        parse_words(typed, needed_by(typed, [option, way]))
    assert " does not work with " in refused.value.message
    way = way.lstrip("!").partition("=")[0]
    assert (way if way[0] == "-" else way.upper()) in refused.value.message


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


ALWAYS = {
    "capture-app": "--sessions --frames --depth",
    "capture-app rig start": "--host --port --sessions --camera --stagger",
    "capture-app leader": "--host --port --sessions --fps --align-row --stagger --lsl --phones "
    "--spool --open",
    "capture-app node": "--name --camera --clock --tolerance-us --clock-tolerance-us --spool "
    "--ring-mb --hold-phase --at-boot --code --pin --open",
    "capture-app relay": "--name --host --port --clock --code --pin --open",
    "capture-app doctor": "--report --spool",
    "capture-app trust add": "--as --name",
    "capture-app trust invite": "--as",
    "capture-app trust pair": "--code",
    "capture-app status": "--watch",
    "capture-app burst": "--cancel",
    "capture-app record": "--stop",
    "capture-app cameras calibrate-time": "--panel --session",
    "capture-app cameras characterize": "--seconds --starts --save",
    "capture-app cameras controls": "--save",
    "capture-app cameras set": "--camera",
    "capture-app preview": "--out --depth --wait-s",
    "capture-app coverage": "--board --square-mm --dictionary --for-s",
    "capture-app serve": "--host --allow-host --port --sessions",
    "capture-app sessions empty-trash": "--yes",
    "capture-app sessions export": "--to --out --hard-link --lossless --instant --masks --points --ros "
    "--codec --sound --wav --whole --near --far --layout --max-points",
    "capture-app sessions import": "--fps --synchronized --timestamps --times --time-shift-ms --align "
    "--start --count --every "
    "--calibration --unit --fit --uncertainty-ms --recording --split --png "
    "--name --out",
    "capture-app sessions list": "--trash",
    "capture-app sessions repair": "--wait-s",
    "capture-app sessions restore": "--as",
    "capture-app sessions sheet": "--out --width --replace",
    "capture-app sessions wiggle": "--out --instant --width --replace",
    "capture-app demo": "--cameras --out --stagger",
    "capture-app link": "--connect",
    "capture-app monitor": "--host --port --certificate",
    "capture-app people": "--osc --lsl --for-s",
    "capture-app panel read": "--out --apply",
    "capture-app panel show": "--save",
    "capture-app panel sketch": "--out --panel --pitch-mm --page",
    "capture-app phones": "--host --port --certificate --size --sound --spool --code --pin",
    "capture-app softwaresync": "--host",
    "reconstruct batch": "--condition --instants --matcher --time-shift-ms --summary --splats --out",
    "reconstruct board": "--page --board --square-mm --marker-mm --dictionary",
    "reconstruct calibrate": "--from",
    "reconstruct compare": "--offset-ms --max-instants --time-shift-ms --condition --against --study --out",
    "reconstruct movers": "--out",
    "reconstruct multiview": "--instant --instants --without --width --matcher --mesh --quick --page "
    "--calibrated --refine --depth --whole --rrd --condition "
    "--time-shift-ms --out",
    "reconstruct panorama": "--instant --register-at --pair --condition --time-shift-ms --out",
    "reconstruct people": "--instants --keypoints --rate --nearest --smooth --up --film "
    "--condition --time-shift-ms --out",
    "reconstruct splat": "--instant --instants --without --masks --iterations --all-cameras "
    "--width --quick --page --spz --condition --time-shift-ms --out",
    "reconstruct stereo": "--instant --pair --condition --time-shift-ms --out",
    "reconstruct time": "--reference --apply --repair-drops",
    "reconstruct tolerance": "--max-offset-ms --pair --max-instants --time-shift-ms --out",
    "reconstruct trajectory": "--instants --condition --time-shift-ms --out",
    "reconstruct view": "--instant --path --fps --instants --masks --quick --page --condition "
    "--time-shift-ms --out",
}
"""Options that have an effect whatever the others are, or of which the data decide; by command."""


@pytest.mark.parametrize("typed", ALL_COMMANDS)
def test_each_option_has_a_rule_or_always_has_an_effect(typed: str) -> None:
    command = ALL_COMMANDS[typed]
    rules = command.rules if isinstance(command, RuledCommand) else ()
    ruled = {name for rule in rules for name in rule.options.split()}
    options = {
        param.opts[0]
        for param in command.get_params(click.Context(command))
        if isinstance(param, click.Option) and not param.hidden
    } - EVERYWHERE
    always = set(ALWAYS.get(typed, "").split())
    undecided = options - ruled - always
    assert not undecided, (
        f"beside which options do these have an effect? give a Rule, or add to ALWAYS: {undecided}"
    )
    assert always <= options - ruled
