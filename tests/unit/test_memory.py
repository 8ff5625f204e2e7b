"""Memory that is free goes back to the system, where the C library can give it back."""

import subprocess
import sys

import pytest

from usdsmoke import memory

PIECES = """
import os
from usdsmoke import memory

def resident() -> int:
    with open("/proc/self/statm") as stream:
        return int(stream.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

pieces = [bytes(60_000) for _ in range(4000)]
for piece in pieces:
    memoryview(piece)  # written when it was made
last = pieces[::40]  # what stays keeps the heap from shrinking by itself
pieces = []
before = resident()
memory.give_back_memory()
print(before - resident())
"""


@pytest.mark.skipif(memory._find_trim() is None, reason="no malloc_trim in this C library")
def test_gaps_between_what_stays_are_given_back() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PIECES], capture_output=True, text=True, check=True, timeout=60
    )
    assert int(done.stdout) > 100e6  # of 240 MB, less what stays


def test_without_the_c_librarys_function_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "_find_trim", lambda: None)
    memory.give_back_memory()
