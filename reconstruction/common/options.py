"""Options of a method: its fields, described once for its command, Python and comparisons."""

import operator
from collections.abc import Callable, Iterator, Mapping
from types import UnionType
from typing import Annotated, Any, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec

from capture_app.common.errors import BadInputError

METHODS = "simulshot.methods"
"""Entry points of methods."""
CHECKS = "simulshot.checks"
"""Entry points of checks, which are parts of comparisons only."""
COMMANDS = "simulshot.reconstruct_commands"
"""Entry points of commands of `reconstruct` that are not methods."""
BOUNDS: Mapping[str, Callable[[Any, Any], bool]] = {"ge": operator.ge, "gt": operator.gt, "le": operator.le}
Pair = tuple[str, str]
"""The names of two cameras."""


def flag(*names: str, **settings: Any) -> msgspec.Meta:
    """Annotate a field of a method with its option of `reconstruct compare`.

    The field's type and default are the option's, `ge`, `gt` and `le` its bounds, and other `settings` are
    click's: `points: Annotated[int, flag("--points", ge=1, help="...")] = 3`. A name without a dash is the
    option's keyword in Python's `CompareOptions.of`, else the field's name is.
    """
    return msgspec.Meta(extra={"names": names, **settings})


def command_flag(*names: str, **settings: Any) -> msgspec.Meta:
    """Annotate a field, as `flag` does, with its option of the method's own command."""
    return flag(*names, own=True, **settings)


Masks = Annotated[
    str | None,
    command_flag(
        "--masks",
        metavar="DIR",
        help="Show only what is white in the masks DIR/CAMERA/INSTANT.png, such as those of "
        "`reconstruct movers`.",
    ),
]
"""A folder of masks, as an option of a method's command."""


class Described(NamedTuple):
    """One option of a field: its type (without None), names, bounds, and click's other settings."""

    field: str
    kind: Any
    own: bool
    """Whether it is an option of the method's own command, else of `reconstruct compare`."""
    names: tuple[str, ...]
    bounds: dict[str, float]
    """By `ge`, `gt` and `le`."""
    settings: dict[str, Any]

    @property
    def keyword(self) -> str:
        """Name of its parameter: its name without dashes, else its field."""
        return next((name for name in self.names if name.isidentifier()), self.field)


def described(options: type[msgspec.Struct]) -> Iterator[Described]:
    """Yield all options that the fields of a method, or of a study's `Options`, describe."""
    for name, hint in get_type_hints(options, include_extras=True).items():
        if get_origin(hint) is Annotated:
            kind, *metas = get_args(hint)
            if get_origin(kind) in (Union, UnionType):
                kind = next(choice for choice in get_args(kind) if choice is not type(None))
            for settings in (dict(meta.extra) for meta in metas if getattr(meta, "extra", None)):
                own, names = settings.pop("own", False), settings.pop("names")
                bounds = {key: settings.pop(key) for key in BOUNDS if key in settings}
                yield Described(name, kind, own, names, bounds, settings)


def compare_keywords(options: type[msgspec.Struct]) -> dict[str, str]:
    """Return the keywords of the options in a comparison, each with its field."""
    return {option.keyword: option.field for option in described(options) if not option.own}


S = TypeVar("S", bound=msgspec.Struct)


def checked(options: S) -> S:
    """Return options with Python's numbers in place of NumPy's.

    Raises:
        BadInputError: one is of the wrong type, or outside the bounds that its field has.
    """
    name = type(options).__name__
    hint = f"help({name}) shows what it takes"
    try:
        result = msgspec.convert(_plain(msgspec.structs.asdict(options)), type(options))
    except msgspec.ValidationError as error:
        raise BadInputError(f"{name}: {error}", hint=hint) from error
    for option in described(type(options)):
        value = getattr(result, option.field)
        if value is not None and not all(BOUNDS[key](value, end) for key, end in option.bounds.items()):
            raise BadInputError(f"{name}: {option.field} cannot be {value}", hint=hint)
    return result


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    return value.item() if hasattr(value, "item") else value
