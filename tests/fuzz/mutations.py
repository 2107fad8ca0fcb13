"""Seeded changes of valid files, such as copying, editing and full disks make."""

import re
from collections.abc import Callable
from random import Random


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


def _replaced(pattern: bytes, *values: bytes) -> Callable[[bytes, Random], bytes]:
    """A mutation that puts one of ``values`` in place of something that has the pattern."""

    def mutation(data: bytes, rng: Random) -> bytes:
        found = list(re.finditer(pattern, data))
        if not found:
            return _flip(data, rng)
        match = rng.choice(found)
        return data[: match.start()] + rng.choice(values) + data[match.end() :]

    return mutation


_number = _replaced(
    rb"[-+.\d][-+.\deE]*", *b"0 -1 1e400 nan inf 1e-320 99999999999 0x1p3 1.5.2 3*0.0 1e200".split(), b""
)
# The likeliest change to go unnoticed.
_digit = _replaced(rb"[-+\d]", b"0", b"1", b"5", b"9", b"-", b"+", b" ")


def _lines(data: bytes, rng: Random) -> bytes:
    lines = data.splitlines(keepends=True)
    one, two = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[one], lines[two] = lines[two], lines[one]
    return b"".join(lines)


def _fields(data: bytes, rng: Random) -> bytes:
    """Two words of a line change places."""
    lines = data.splitlines(keepends=True)
    at = rng.randrange(len(lines))
    words = re.split(rb"([\s,]+)", lines[at])
    one, two = (2 * rng.randrange((len(words) + 1) // 2) for _ in range(2))
    words[one], words[two] = words[two], words[one]
    lines[at] = b"".join(words)
    return b"".join(lines)


def _again(data: bytes, rng: Random) -> bytes:
    """Some lines stand there twice."""
    lines = data.splitlines(keepends=True)
    first = rng.randrange(len(lines))
    last = first + rng.randrange(1, 12)
    return b"".join([*lines[:last], *lines[first:last], *lines[last:]])


def _editor(data: bytes, rng: Random) -> bytes:
    """What editors do to a whole file: ends of lines, a byte order mark, another encoding, no last end of line."""
    blank = rng.choice((b"\t", b"\xc2\xa0", b"\x0b", b"  "))
    return rng.choice((
        data.replace(b"\n", b"\r\n"), data.replace(b"\n", b"\r"), b"\xef\xbb\xbf" + data,
        data.decode("latin-1").encode("utf-16"), data.rstrip(), data.replace(b" ", blank),
    ))  # fmt: skip


def _letters(data: bytes, rng: Random) -> bytes:
    """Digits of another script, signs that look alike, a decimal comma, case of letters."""
    old = bytes([rng.choice(re.findall(rb"[-.\da-zA-Z]", data) or [b"x"])[0]])
    new = {b"-": "\u2212".encode(), b".": b","}.get(old, old.swapcase())
    if old.isdigit():
        new = chr(rng.choice((0xFF10, 0x660)) + int(old)).encode()
    at = rng.randrange(data.count(old) or 1)
    parts = data.split(old)
    return old.join(parts[: at + 1]) + new + old.join(parts[at + 1 :])


BINARY: tuple[Callable[[bytes, Random], bytes], ...] = (_flip, _truncate, _extend, _repeat, _drop, _blank)
TEXT = (
    *BINARY, _number, _number, _number, _lines, _fields, _fields, _again, _editor, _letters,
    _digit, _digit, _digit, _digit,
)  # fmt: skip


def mutated(data: bytes, text: bool, rng: Random) -> bytes:
    """``data`` with one to three changes."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(TEXT if text else BINARY)(data, rng) or b"\n"
    return data
