"""Mutations of what JSON and YAML hold: mappings, lists and plain values."""

import copy
import json
from collections.abc import Iterator
from random import Random
from typing import Any

import yaml

_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 3.7, 1e300, -0.0, float("nan"), float("inf"), 2**31, 2**63),
    *(
        10**30,
        "",
        "a",
        "1",
        "nan",
        "x" * 5000,
        "é\n\x1b[31m",
        [],
        {},
        [[]],
        [None],
        {"a": 1},
        ["a"],
    ),
    *([0] * 1000, {"": ""}, "../../etc/passwd", 100000001),
)
Place = tuple[Any, Any]  # a container, and a key or an index of it


def places(tree: Any) -> Iterator[Place]:
    """Every container with each of its keys."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree)
    for key, value in list(items):
        yield tree, key
        if isinstance(value, dict | list):
            yield from places(value)


def mutated_tree(tree: Any, draw: Random, values: tuple[Any, ...] = _VALUES) -> Any:
    """A copy with something deleted, renamed, repeated, swapped, nested or of another type."""
    tree = copy.deepcopy(tree)
    spots = list(places(tree))
    container, key = draw.choice(spots)
    value = container[key]
    kind = draw.randrange(9)
    if kind == 0:
        del container[key]
    elif kind == 1 and isinstance(container, dict):
        text = str(key)
        names = (text + "_", text[:-1], text.upper(), "", "a", "__class__", str(draw.randrange(9)))
        container[draw.choice(names)] = container.pop(key)
    elif kind == 2:
        other, place = draw.choice(spots)
        # Copies: a place may lie inside the other.
        container[key], other[place] = copy.deepcopy(other[place]), copy.deepcopy(value)
    elif kind == 3:
        container[key] = nested(value, draw.choice([1, 2, 100]), draw)
    elif kind == 4 and isinstance(value, list):
        if value and draw.random() < 0.5:
            value.append(copy.deepcopy(draw.choice(value)))
        else:
            value *= draw.choice([0, 2, 100])
    elif kind == 5 and isinstance(value, str | int | float) and not isinstance(value, bool):
        container[key] = _near(value, draw)
    else:
        container[key] = copy.deepcopy(draw.choice(values))
    return tree


def nested(value: Any, depth: int, draw: Random) -> Any:
    for _ in range(depth):
        value = [value] if draw.random() < 0.5 else {"a": value}
    return value


def _near(value: str | float, draw: Random) -> Any:
    if isinstance(value, str):
        return draw.choice([value + "x", value[:-1], value.upper(), f" {value}", [value], "x"])
    return draw.choice(
        [value + 1, -value, value * 1e6, str(value), [value], value + 0.5, value / 2]
    )


def as_json(tree: Any, draw: Random) -> str:
    """As JSON text, sometimes with a key twice, or lists nested too deep."""
    text = json.dumps(tree, ensure_ascii=draw.random() < 0.8)
    kind = draw.randrange(20)
    if kind == 0:
        deep = draw.choice([500, 100000])
        open_, close = draw.choice([("[", "]"), ('{"a":', "}")])
        return text.replace(draw.choice(["null", "1", '""']), open_ * deep + "1" + close * deep, 1)
    if kind == 1:
        spots = [i for i, char in enumerate(text) if char == "{" and text[i + 1] == '"']
        if spots:
            place = draw.choice(spots) + 1
            end = text.index('"', place + 1)
            name = text[place : end + 1]
            return (
                text[:place] + f"{name}: {draw.choice(['0', 'null', '[]', '1'])}, " + text[place:]
            )
    if kind == 2:
        digits = [i for i, char in enumerate(text) if char.isdigit()]
        if digits:
            place = draw.choice(digits)
            odd = draw.choice(["1e999", "-1e999", "NaN", "9" * 5000, "0x10", "01", "1_0", "-"])
            return text[:place] + odd + text[place + 1 :]
    return text


def as_yaml(tree: Any, draw: Random) -> str:
    """As YAML text, sometimes with tags that ask for code, bombs of aliases or a key twice."""
    text = yaml.safe_dump(tree, sort_keys=False)
    kind = draw.randrange(12)
    lines = text.splitlines(keepends=True)
    place = draw.randrange(len(lines))
    if kind == 0:
        return text + "_bomb:\n" + _bomb() + "  z: *a30\n"
    if kind == 1:
        lines.insert(place, lines[place])
    elif kind == 2:
        deep = draw.choice([100, 5000])
        return text + "_deep: " + "[" * deep + "]" * deep + "\n"
    elif kind == 3:
        lines[place] = lines[place].replace("  ", "\t", 1)
    elif kind == 4:
        head, colon, _ = lines[place].partition(":")
        lines[place] = f"{head}{colon} {draw.choice(_TAGS)}\n"
    return "".join(lines)


_TAGS = (
    "!!python/object/apply:os.system ['touch MARKER']",
    "!!python/name:os.system",
    "!!python/object/new:pathlib.Path ['MARKER']",
    "!!binary aGFsbG8=",
    "!!timestamp 2020-01-01",
    "!unknown {}",
    "2020-01-01",
    "0777",
    "1:30:00",
    "*missing",
    "&a [*a]",
    "<<",
    ".inf",
    ".nan",
    "1e999",
)


def _bomb() -> str:
    lines = ["  a0: &a0 [x, x]\n"]
    lines += [f"  a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 31)]
    return "".join(lines)
