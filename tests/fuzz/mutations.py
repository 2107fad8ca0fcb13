"""Seeded changes of valid files, such as copying, editing and full disks make."""

from __future__ import annotations

import re
from collections.abc import Callable
from random import Random

NUMBERS = (
    b"0",
    b"-1",
    b"1e400",
    b"nan",
    b"inf",
    b"1e-320",
    b"99999999999",
    b"0x1p3",
    b"1.5.2",
    b"3*0.0",
    b"",
    b"1e200",
)


def _flip(data: bytes, rng: Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]


def _truncate(data: bytes, rng: Random) -> bytes:
    return data[: rng.randrange(len(data))]


def _extend(data: bytes, rng: Random) -> bytes:
    return data + bytes(rng.randrange(256) for _ in range(rng.randrange(1, 40)))


def _repeat(data: bytes, rng: Random) -> bytes:
    first = rng.randrange(len(data))
    last = min(len(data), first + rng.randrange(1, 64))
    return data[:last] + data[first:last] + data[last:]


def _drop(data: bytes, rng: Random) -> bytes:
    first = rng.randrange(len(data))
    return data[:first] + data[first + rng.randrange(1, 64) :]


def _blank(data: bytes, rng: Random) -> bytes:
    first = rng.randrange(len(data))
    count = min(rng.randrange(1, 16), len(data) - first)
    return data[:first] + bytes([rng.choice((0, 255, 32, 10))]) * count + data[first + count :]


def _number(data: bytes, rng: Random) -> bytes:
    found = list(re.finditer(rb"[-+.\d][-+.\deE]*", data))
    if not found:
        return _flip(data, rng)
    match = rng.choice(found)
    return data[: match.start()] + rng.choice(NUMBERS) + data[match.end() :]


def _digit(data: bytes, rng: Random) -> bytes:
    """One digit or sign is another: the likeliest change to go unnoticed."""
    found = list(re.finditer(rb"[-+\d]", data))
    if not found:
        return _flip(data, rng)
    at = rng.choice(found).start()
    return data[:at] + rng.choice((b"0", b"1", b"5", b"9", b"-", b"+", b" ")) + data[at + 1 :]


def _lines(data: bytes, rng: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    one, two = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[one], lines[two] = lines[two], lines[one]
    return b"".join(lines)


BINARY: tuple[Callable[[bytes, Random], bytes], ...] = (_flip, _truncate, _extend, _repeat, _drop, _blank)
TEXT = (*BINARY, _number, _number, _lines, _digit, _digit, _digit, _digit)


def mutated(data: bytes, text: bool, rng: Random) -> bytes:
    """``data`` with one to three changes."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(TEXT if text else BINARY)(data, rng) or b"\n"
    return data
