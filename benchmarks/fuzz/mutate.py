"""Ways to damage a file: bytes of any format, words of a text, values of JSON and YAML."""

import json
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

__all__ = ["damage_bytes", "damage_json", "damage_text"]

_NUMBERS = "0 -1 1 2 1e-40 1e40 1e308 -1e308 nan inf -inf 2147483648 18446744073709551616".split()
_WORDS = [
    *_NUMBERS, "true", "None", "null", '""', '"x"', "@@", "@./gone.vdb@", "@.@", "</>", "<>",
    "</World/smoke>", "[]", "()", "{}", "[[1]]", "(1, 2, 3)", "{1: 2}", "*a", "&a", "!!python/none",
    "rel", "def", "over", "Volume", "OpenVDBAsset", "density", "token", "asset", "float[]",
    "é", "\U0001f4a8", "\x00", "\x1b[2J", "%s%n", "../" * 8, "a" * 300, ".",
]  # fmt: skip
_INTEGERS = (0, 1, 127, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**32 - 1, 2**53, 2**63 - 1, 2**64 - 1)


def damage_bytes(data: bytes, draw: np.random.Generator) -> bytes:
    """One damage, seldom up to four: flipped bits, other numbers, cuts, repeats, zeros, noise."""
    found = bytearray(data)
    for _ in range(_few(draw)):
        _pick(_BYTES, draw)(found, draw)
    return bytes(found)


def damage_text(data: bytes, draw: np.random.Generator) -> bytes:
    """A word or a line is replaced, removed, repeated or swapped, seldom several; or bytes."""
    if draw.random() < 0.15:
        return damage_bytes(data, draw)
    text = data.decode("utf-8", "surrogateescape")
    for _ in range(_few(draw)):
        text = _damage_words(text, draw) if draw.random() < 0.7 else _damage_lines(text, draw)
    return text.encode("utf-8", "surrogateescape")


def damage_json(data: bytes, draw: np.random.Generator) -> bytes:
    """A value is replaced by one of another kind, or removed; else the text is damaged."""
    try:
        tree = json.loads(data)
    except ValueError:
        return damage_text(data, draw)
    places = list(_places(tree))
    if not places or draw.random() < 0.3:
        return damage_text(data, draw)
    holder, key = places[int(draw.integers(len(places)))]
    if draw.random() < 0.3:
        del holder[key]
    else:
        values = (None, True, -1, 0, 1e308, float("nan"), 2**70, "", "x", "../..", [], {}, [[]])
        holder[key] = values[int(draw.integers(len(values)))]
    return json.dumps(tree).encode()


def _few(draw: np.random.Generator) -> int:
    return int(_pick((1, 1, 1, 1, 1, 2, 2, 3, 4), draw))


def _pick(choices: Sequence[Any], draw: np.random.Generator) -> Any:
    return choices[int(draw.integers(len(choices)))]


def _span(data: bytearray, draw: np.random.Generator) -> slice:
    """A place in the data; half of all in the beginning, where formats keep their tables."""
    size = len(data) if draw.random() < 0.5 else min(len(data), 512)
    begin = int(draw.integers(size + 1))
    return slice(begin, begin + int(2 ** draw.uniform(0, 8)))


def _flip(data: bytearray, draw: np.random.Generator) -> None:
    if data:
        data[_span(data, draw).start % len(data)] ^= 1 << int(draw.integers(8))


def _number(data: bytearray, draw: np.random.Generator) -> None:
    begin, width = _span(data, draw).start, int(_pick((1, 2, 4, 8), draw))
    value = int(_pick(_INTEGERS, draw)) % 256**width
    order = "little" if draw.random() < 0.7 else "big"
    data[begin : begin + width] = value.to_bytes(width, order)  # type: ignore[arg-type]


def _not_finite(data: bytearray, draw: np.random.Generator) -> None:
    begin = _span(data, draw).start // 4 * 4
    data[begin : begin + 4] = np.float32(_pick((np.nan, np.inf, 3e38, -1e-40), draw)).tobytes()


def _cut(data: bytearray, draw: np.random.Generator) -> None:
    del data[_span(data, draw)]


def _truncate(data: bytearray, draw: np.random.Generator) -> None:
    del data[_span(data, draw).start :]


def _repeat(data: bytearray, draw: np.random.Generator) -> None:
    span = _span(data, draw)
    data[span.start : span.start] = data[span]


def _zero(data: bytearray, draw: np.random.Generator) -> None:
    span = _span(data, draw)
    data[span] = bytes(len(data[span]))


def _noise(data: bytearray, draw: np.random.Generator) -> None:
    span = _span(data, draw)
    data[span] = draw.bytes(len(data[span]))


_BYTES: tuple[Callable[[bytearray, np.random.Generator], None], ...] = (
    _flip, _flip, _number, _number, _not_finite, _cut, _truncate, _repeat, _zero, _noise,
)  # fmt: skip


def _damage_words(text: str, draw: np.random.Generator) -> str:
    words = list(re.finditer(r'"[^"\n]*"|@[^@\n]*@|<[^>\n]*>|[\w.+-]+|[^\s\w]', text))
    if not words:
        return text
    word = _pick(words, draw)
    if draw.random() < 0.7:  # by one of its kind, so that the file still parses
        kin = [item.group() for item in words if _kind(item.group()) == _kind(word.group())]
        new = str(
            _pick(kin + [item for item in _WORDS if _kind(item) == _kind(word.group())], draw)
        )
    else:
        new = str(_pick(["", *_WORDS], draw))
    return text[: word.start()] + new + text[word.end() :]


def _kind(word: str) -> str:
    """A quote, an asset's @, a path's <, a digit, a letter: what a word may be replaced by."""
    first = word[:1]
    return "0" if first.isdigit() or word in _NUMBERS else "a" if first.isalpha() else first


def _damage_lines(text: str, draw: np.random.Generator) -> str:
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    a, b = (int(draw.integers(len(lines))) for _ in range(2))
    kind = int(draw.integers(4))
    if kind == 0:
        del lines[a]
    elif kind == 1:
        lines.insert(b, lines[a])
    elif kind == 2:
        lines[a], lines[b] = lines[b], lines[a]
    else:  # very deep or very long
        lines.insert(a, _pick(("[" * 2000, "a: " * 50, "(" * 500, "x" * 100_000), draw) + "\n")
    return "".join(lines)


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every (holder, key) of a tree of lists and dictionaries."""
    if not isinstance(tree, (dict, list)):
        return
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        yield tree, key
        yield from _places(value)
