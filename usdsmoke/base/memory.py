"""Memory that is free but not given back: the C library keeps it, and a long run seems to grow."""

import ctypes
from functools import lru_cache
from typing import Any

__all__ = ["give_back_memory"]


def give_back_memory() -> None:
    """Let the system have what the C library holds in pieces; does nothing where it cannot.

    Fields of many sizes leave gaps between them. Without this a shot of 72 frames peaked a tenth
    above one of 24 (benchmarks/window_cost.py). It takes about two milliseconds: call it between
    frames, and before what takes seconds.
    """
    trim = _find_trim()
    if trim is not None:
        trim(0)


@lru_cache(maxsize=1)
def _find_trim() -> Any | None:
    """``malloc_trim`` of the GNU C library; None with any other one."""
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):
        return None
