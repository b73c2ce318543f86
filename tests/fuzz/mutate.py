"""Seeded mutations: of the values of a parsed file, and of the bytes of any file.

Nothing here knows what a mutation means. Most make an input wrong, some leave it right; the commands
must tell which.
"""

from __future__ import annotations

import copy
from datetime import date
from random import Random
from typing import Any

UGLY: tuple[Any, ...] = (
    0, 0.0, -0.0, 1, -1, 0.5, 3, 1e-12, 5e-324, 1e12, 1e308, -1e308, 2**31, 2**63, -(2**63), 10**30, 10**400,
    float("nan"), float("inf"), float("-inf"), True, False, "", " ", "x", "0", "nan", "1e3", "\x00", "a\x00b", "a\nb",
    "\x1b[31m", "[red]", "[/red]", ":smile:", "{}", "%s", "ünïcode", "\u202e", "surgeon", "nurse", "world", "floor",
    "tool", "planar3", "pa10", "/dev/zero", "/dev/null", "/", ".", "..", "../..", "~", "a" * 300, "b" * 5000,
    "/" + "c/" * 2500, [], [[]], {}, {"x": 1}, [0.0], [1, 2, 3], [1e308] * 3, [float("nan")] * 7, [True], ["x"] * 3,
    date(2008, 5, 19), [[[[[[[[[]]]]]]]]],
)  # fmt: skip
"""Values that some code somewhere has not thought of."""


def tables(random: Random, content: Any, count: int) -> Any:
    """A copy of a parsed file with some of its keys and values changed."""
    changed = copy.deepcopy(content)
    for _ in range(count):
        _change(random, changed)
    return changed


def _change(random: Random, content: Any) -> None:
    holders = list(_holders(content))
    if not holders:
        return
    # Deep places are many; every depth gets its turn.
    depth = random.choice(sorted({d for d, _ in holders}))
    holder = random.choice([h for d, h in holders if d == depth])
    keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
    if not keys:
        return
    key = random.choice(keys)
    value = holder[key]
    match random.randrange(9):
        case 0 | 1 | 2:
            holder[key] = copy.deepcopy(random.choice(UGLY))
        case 3:
            del holder[key]
        case 4 if isinstance(holder, dict):
            holder[typing_error(random, str(key))] = holder.pop(key)
        case 4:
            holder.insert(key, copy.deepcopy(value))
        case 5 if isinstance(value, list):
            value.extend(copy.deepcopy(value) * random.choice((1, 2, 30)))
        case 5 | 6 if isinstance(value, (int, float)) and not isinstance(value, bool):
            holder[key] = value * random.choice((-1, 0.1, 0.9, 1.1, 10, 1e3, 1e6, 1e-6))
        case 6 if isinstance(value, str):
            holder[key] = typing_error(random, value)
        case 7:
            other = random.choice([h for _, h in holders])
            if isinstance(other, dict):
                other[str(key)] = copy.deepcopy(value)
            else:
                other.append(copy.deepcopy(value))
        case _:
            _, other = random.choice(holders)
            inner = list(other) if isinstance(other, dict) else list(range(len(other)))
            if inner:
                holder[key] = copy.deepcopy(other[random.choice(inner)])


def _holders(node: Any, depth: int = 0):
    """Every table and list, with how deep it lies."""
    if isinstance(node, dict):
        yield depth, node
        for value in node.values():
            yield from _holders(value, depth + 1)
    elif isinstance(node, list):
        yield depth, node
        for value in node:
            yield from _holders(value, depth + 1)


def typing_error(random: Random, word: str) -> str:
    """The word with a letter dropped, doubled, swapped or replaced."""
    if not word:
        return "x"
    k = random.randrange(len(word))
    return random.choice(
        (
            word[:k] + word[k + 1 :],
            word[:k] + word[k] + word[k:],
            word[: max(k - 1, 0)] + word[k : k + 1] + word[max(k - 1, 0) : k] + word[k + 1 :],
            word[:k] + random.choice("abcxyz_0. ") + word[k + 1 :],
        )
    )


def damaged(random: Random, content: bytes) -> bytes:
    """A copy of a file's bytes with flips, holes, insertions, repetitions, or its end missing."""
    changed = bytearray(content)
    for _ in range(random.choice((1, 1, 1, 2, 5, 50))):
        if not changed:
            return bytes(changed)
        at = random.randrange(len(changed))
        length = random.choice((1, 2, 8, 100, 5000))
        match random.randrange(7):
            case 0:
                changed[at] ^= 1 << random.randrange(8)
            case 1:
                del changed[at:]
            case 2:
                del changed[at : at + length]
            case 3:
                changed[at:at] = random.randbytes(length)
            case 4:
                changed[at:at] = changed[at : at + length]
            case 5:
                changed[at : at + length] = bytes(min(length, len(changed) - at))
            case _:
                changed[at] = random.randrange(256)
    return bytes(changed)
