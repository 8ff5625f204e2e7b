"""What the commands print of a plan: ten lines, or all of it."""

import re
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from usdsmoke.base.errors import REFUSED, count_text
from usdsmoke.base.time_codes import format_time_code, format_time_codes, name_time_codes
from usdsmoke.ui.cli.text import box_text, format_seconds

if TYPE_CHECKING:
    from usdsmoke.planning.plan import Omission, Plan, VolumePlan

_MOST_LINES = 10
_MOST_VOLUMES = 3  # that have a line each
_WIDTH = 100
_SHORTEST = 30  # letters that a shortened sentence keeps at least
_MOST_NAMED = 24  # letters of timeCodes in the line of a Volume
_SENTENCE_END = re.compile(r"\. (?=[A-Z])")
_PATH = re.compile(r"</[^>]*>")
_CLAUSE_END = re.compile(r"[,;:.](?= )")


def plan_text(plan: "Plan", everything: bool = False) -> str:
    """A plan: the Volumes, what is unusual, what it costs.

    Args:
        everything: also list windows, all that is needed, and what every run of this kind leaves
            out. False: ten lines at most, in which sentences are shortened.
    """
    return "\n".join(_all_lines(plan) if everything else _few_lines(plan))


def _few_lines(plan: "Plan") -> list[str]:
    head = [f"plan for {plan.source.file_path}", *_volume_lines(plan.volumes)]
    head += [line for text in plan.warnings for line in warning_lines(text)]
    items = [
        f"  {text}" if text.startswith(REFUSED) else _shorten(f"  {text}")
        for text in _unusual(plan)
    ]
    room = max(_MOST_LINES - len(head) - 2, 0)
    hidden = items[room:]
    more = f"{count_text(len(hidden), 'more remark')}, " if hidden else ""
    return [
        *head,
        *items[:room],
        f"estimate: {_costs(plan)}",
        f"--verbose lists {more}what is needed and all that is left out",
    ]


def _unusual(plan: "Plan") -> list[str]:
    """What is unusual, most telling first."""
    hidden = [item for item in plan.omitted if not item.expected]
    requests = [volume.request_text for volume in plan.volumes if volume.request_text]
    return _merged([*plan.notes, *requests, *(f"left out: {_omission(item)}" for item in hidden)])


def _merged(texts: Sequence[str]) -> list[str]:
    """Sentences that differ in a prim's path alone are one, with the number of the others.

    >>> _merged(["grid heat of </a>: stays", "grid heat of </b>: stays", "</c>: is cut"])
    ['grid heat of </a> and 1 more: stays', '</c>: is cut']
    """
    alike: dict[str, list[str]] = {}
    for text in texts:
        alike.setdefault(_PATH.sub("<>", text), []).append(text)
    return [
        _PATH.sub(rf"\g<0> and {len(same) - 1} more", same[0], count=1) if same[1:] else same[0]
        for same in alike.values()
    ]


def _all_lines(plan: "Plan") -> list[str]:
    lines = [
        f"plan for {plan.source.file_path}",
        *(f"  {_volume_line(volume)}, written to {_files(volume)}" for volume in plan.volumes),
        *(f"  warning: {text}" for text in plan.warnings),
        *_window_lines(plan),
        *(f"  {volume.request_text}" for volume in plan.volumes if volume.request_text),
        "needed",
        *(f"  {sentence}" for sentence in plan.needed),
    ]
    if plan.omitted:
        lines += ["left out", *(f"  {_omission(item)}" for item in plan.omitted)]
    lines += ["notes", *(f"  {note}" for note in plan.notes)] if plan.notes else []
    return [*lines, "estimate", f"  {_costs(plan)}"]


def warning_lines(text: str) -> list[str]:
    """A warning, never shortened."""
    return textwrap.wrap(
        f"warning: {text}",
        _WIDTH,
        initial_indent="  ",
        subsequent_indent="    ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def _omission(item: "Omission") -> str:
    return f"{item.what}: {item.reason}"


def _volume_lines(volumes: Sequence["VolumePlan"]) -> list[str]:
    """A line each for the first few, and one for the others."""
    shown = volumes if len(volumes) <= _MOST_VOLUMES else volumes[: _MOST_VOLUMES - 1]
    lines = [f"  {_volume_line(volume)}" for volume in shown]
    others = volumes[len(shown) :]
    if others:
        frames, windows = (
            count_text(sum(map(len, items)), noun)
            for items, noun in (
                ([volume.frames for volume in others], "frame"),
                ([volume.windows for volume in others], "window"),
            )
        )
        lines.append(f"  and {len(others)} more Volumes: {frames} in {windows}")
    return lines


def _volume_line(volume: "VolumePlan") -> str:
    largest = max(volume.frames, key=lambda frame: frame.size.active_voxels)
    codes = [frame.source.time_code for frame in volume.frames]
    named = format_time_codes(codes)
    if len(named) > _MOST_NAMED:
        named = f"from {format_time_code(codes[0])} to {format_time_code(codes[-1])}"
    return (
        f"<{volume.source.prim_path}>: {count_text(len(codes), 'frame')} ({named}) in "
        f"{count_text(len(volume.windows), 'window')}, up to {largest.size.active_voxels:,} "
        f"voxels in {box_text(largest.size.box)}"
    )


def _files(volume: "VolumePlan") -> str:
    return f"{volume.file_of(volume.frames[0])}{' ...' if len(volume.frames) > 1 else ''}"


def _window_lines(plan: "Plan") -> list[str]:
    """The windows by number, where there are several."""
    lines = []
    for volume in plan.volumes:
        for window in volume.windows:
            line = f"  window {window.index}: <{volume.source.prim_path}> "
            line += name_time_codes(window.time_codes)
            if window.overlap:
                shared = format_time_codes(window.overlap)
                line += f", and {shared} shared with window {window.index + 1}"
            lines.append(line)
    return ["windows", *lines] if len(lines) > 1 else []


def _costs(plan: "Plan") -> str:
    estimate = plan.estimate
    return (
        f"{estimate.memory_gib:.1f} GiB of memory, {format_seconds(estimate.seconds)}, "
        f"{_size(estimate.bytes_written)} on disk, up to {_size(estimate.bytes_temporary)} of "
        "temporary files"
    )


def _shorten(text: str) -> str:
    """The first sentence, or as many of its clauses as a line holds.

    >>> _shorten("  it is coarse. Set grids.refine=4")
    '  it is coarse'
    >>> _shorten("a first clause that says the most, " + "and a second one that is long " * 3)
    'a first clause that says the most ...'
    """
    first = _SENTENCE_END.split(text, maxsplit=1)[0].rstrip(".")
    if len(first) <= _WIDTH:
        return first
    ends = [match.start() for match in _CLAUSE_END.finditer(first[: _WIDTH - 4])]
    ends = [end for end in ends if end >= _SHORTEST] or [first.rfind(" ", 0, _WIDTH - 4)]
    return f"{first[: ends[-1]] if ends[-1] > 0 else first[: _WIDTH - 4]} ..."


def _size(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:,.0f} MB" if n_bytes >= 1e6 else f"{n_bytes / 1e3:,.0f} kB"
