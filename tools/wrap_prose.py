"""Wrap the paragraphs of Markdown files at 100 columns, each line as full as it can be.

    python tools/wrap_prose.py FILE ...

Tables, code, headings, pictures and HTML stay as they are.
"""

import re
import sys
import textwrap
from pathlib import Path

__all__ = ["wrap_prose"]

WIDTH = 100
_KEPT = ("|", "#", "![", "    ", "```", "<", "[^")
_ITEM = re.compile(r"(\s*)([-*] |\d+\. )?")


def wrap_prose(text: str) -> str:
    """The text with its paragraphs and list items wrapped."""
    lines, wrapped, in_code = text.split("\n"), [], False
    while lines:
        line = lines.pop(0)
        if line.strip().startswith("```"):
            in_code = not in_code
        if in_code or not line.strip() or line.startswith(_KEPT) or line.strip() == "```":
            wrapped.append(line)
            continue
        head = _match(line)
        indent, words = " " * len(head), line[len(head) :].split()
        while lines and _goes_on(lines[0], indent):
            words += lines.pop(0).split()
        wrapped += textwrap.wrap(
            " ".join(words),
            WIDTH,
            initial_indent=head,
            subsequent_indent=indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
    return "\n".join(wrapped)


def _goes_on(line: str, indent: str) -> bool:
    """Whether a line belongs to the paragraph before it."""
    is_kept = line.startswith(tuple(set(_KEPT) - {"    "})) or line.strip().startswith("```")
    return bool(line.strip()) and not is_kept and line.startswith(indent) and not _is_item(line)


def _is_item(line: str) -> bool:
    return bool(re.match(r"\s*([-*] |\d+\. )", line))


def _match(line: str) -> str:
    found = _ITEM.match(line)
    return found[0] if found else ""


if __name__ == "__main__":
    for name in sys.argv[1:]:
        path = Path(name)
        path.write_text(wrap_prose(path.read_text("utf-8")), "utf-8")
