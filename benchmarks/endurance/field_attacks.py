"""Every field of every message type with values that no honest machine sends, made from the types themselves.

A field that is added to a message is attacked without a change here.
"""

import re
from collections.abc import Iterator
from typing import Any

from msgspec import inspect

TEXTS = ("cam1", "0" * 64, "", "1", "x")
"""Candidates for an example of a text: a name, a checksum, a pin, a digit, any text."""
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1, 2**31, 2**53, 2**62, -(2**62), 2**63 - 1, -(2**63), 2**64 - 1, 1e16, -1e300, 1e308,
    float("nan"), float("inf"), "", "cam2", "../..", "\x1b[2J", "x" * 201, "x" * 20_000, [], {}, [[]] * 3,
)  # fmt: skip
MANY = 1_001


def example(kind: inspect.Type) -> Any:  # noqa: C901, PLR0912 - a case for each kind of type
    """Return plain data that decodes to a type, with all of its optional fields."""
    match kind:
        case inspect.DataclassType(fields=fields):
            return {field.encode_name: example(field.type) for field in fields}
        case inspect.StructType(fields=fields, tag=tag, tag_field=tag_field, array_like=array_like):
            plain = {field.encode_name: example(field.type) for field in fields}
            head = {} if tag is None or tag_field is None else {tag_field: tag}
            return [*head.values(), *plain.values()] if array_like else {**head, **plain}
        case inspect.UnionType(types=types):
            return example(next(one for one in types if not isinstance(one, inspect.NoneType)))
        case inspect.VarTupleType(item_type=item) | inspect.ListType(item_type=item):
            return [example(item)]
        case inspect.TupleType(item_types=items):
            return [example(item) for item in items]
        case inspect.DictType(key_type=key, value_type=value):
            return {example(key): example(value)}
        case inspect.EnumType(cls=cls):
            return next(iter(cls)).value
        case inspect.LiteralType(values=values):
            return values[0]
        case inspect.StrType(pattern=pattern):
            return next(text for text in TEXTS if pattern is None or re.search(pattern, text))
        case inspect.IntType(ge=least):
            return max(1, least or 0)
        case inspect.FloatType(ge=least, gt=below):
            return max(0.0, least or 0.0) if below is None or below < 0 else below + 1.0
        case inspect.BoolType():
            return False
        case inspect.BytesType():
            return ""
    raise NotImplementedError(f"no example of {kind}")


def attacks(  # noqa: C901, PLR0912 - a case for each kind of type
    kind: inspect.Type, plain: Any
) -> Iterator[tuple[str, Any]]:
    """Yield the path of each part of an example, and the example with another value or none in its place."""
    for value in VALUES:
        yield "", value
    match kind:
        case inspect.DataclassType(fields=fields):
            for field in fields:
                for path, part in attacks(field.type, plain[field.encode_name]):
                    yield f".{field.name}{path}", _replaced(plain, field.encode_name, part)
        case inspect.StructType(fields=fields, tag=tag, array_like=array_like):
            for number, field in enumerate(fields, tag is not None):
                key: Any = number if array_like else field.encode_name
                for path, part in attacks(field.type, plain[key]):
                    yield f".{field.name}{path}", _replaced(plain, key, part)
                if not array_like:
                    yield f".{field.name}", {name: part for name, part in plain.items() if name != key}
            if not array_like:
                yield "", {**plain, "unknown": 1}
        case inspect.UnionType(types=types):
            first = next(one for one in types if not isinstance(one, inspect.NoneType))
            yield from ((path, part) for path, part in attacks(first, plain) if path)
        case inspect.VarTupleType(item_type=item) | inspect.ListType(item_type=item):
            yield "[]", plain * MANY
            yield from ((f"[]{path}", [part]) for path, part in attacks(item, plain[0]))
        case inspect.TupleType(item_types=items):
            for number, item in enumerate(items):
                for path, part in attacks(item, plain[number]):
                    yield f"[{number}]{path}", _replaced(plain, number, part)
        case inspect.DictType(key_type=key_type, value_type=value_type):
            (key, value), *_ = plain.items()
            yield "{}", {f"{key}{number}": value for number in range(MANY)}
            for path, part in attacks(value_type, value):
                yield f"{{}}{path}", {key: part}
            for path, part in attacks(key_type, key):
                if isinstance(part, str):
                    yield f"{{}}{path}", {part: value}


def _replaced(plain: Any, key: Any, part: Any) -> Any:
    if isinstance(plain, dict):
        return {**plain, key: part}
    return [*plain[:key], part, *plain[key + 1 :]]
