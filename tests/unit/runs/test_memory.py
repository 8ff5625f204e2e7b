"""Memory: free pieces go back to the system, and no step holds more than it needs at once."""

import subprocess
import sys
from pathlib import Path

import pytest

from usdsmoke.base import machine

PIECES = """
import os
from usdsmoke.base import machine

def resident() -> int:
    with open("/proc/self/statm") as stream:
        return int(stream.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

pieces = [bytes(60_000) for _ in range(4000)]
for piece in pieces:
    memoryview(piece)  # written when it was made
last = pieces[::40]  # what stays keeps the heap from shrinking by itself
pieces = []
before = resident()
machine.give_back_memory()
print(before - resident())
"""


@pytest.mark.skipif(machine._find_trim() is None, reason="no malloc_trim in this C library")
def test_gaps_between_what_stays_are_given_back() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PIECES], capture_output=True, text=True, check=True, timeout=60
    )
    assert int(done.stdout) > 100e6  # of 240 MB, less what stays


def test_without_the_c_librarys_function_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "_find_trim", lambda: None)
    machine.give_back_memory()


# Bytes a voxel while the map of a picture is made, and what a refined field takes of its own size.
PICTURES = """
import os
import numpy as np
import torch
from usdsmoke.core.views.project import colour_map
from usdsmoke.core.fields.resample import refine_field
from usdsmoke.core.views.cameras import orbit_view
from usdsmoke.base.machine import give_back_memory
from usdsmoke.base.volume import DenseField

def status(name: str) -> int:
    with open("/proc/self/status") as stream:
        return next(int(line.split()[1]) * 1024 for line in stream if line.startswith(name))

def growth(make) -> int:
    give_back_memory()
    with open("/proc/self/clear_refs", "w") as stream:
        stream.write("5")  # the highest mark falls to what is resident now
    before = status("VmRSS")
    make()
    return status("VmHWM") - before

def picture(n: int) -> int:
    ijk = torch.cartesian_prod(*(torch.arange(n) for _ in range(3))).double()
    view = orbit_view(0.0, 0.0, "Y", np.full(3, n / 2), n + 2, n + 2, 1.0)
    density = torch.ones(len(ijk))
    return growth(lambda: colour_map(ijk, density, np.eye(3), 0.1, view, 1.0)) / len(ijk)

def refined(n: int) -> float:
    field = DenseField("e", np.ones((n, n, n, 3), np.float32), (0, 0, 0), np.eye(4), (0.0,) * 3,
                       "unknown", False)
    return growth(lambda: refine_field(field, 2)) / (field.values.nbytes * (2 + 4 / n) ** 3)

torch.set_num_threads(1)
picture(8), refined(4)  # what is loaded at first use
print(picture(80), refined(40))
"""


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the kernel keeps no marks")
def test_a_picture_takes_a_few_times_its_map_and_a_refined_field_little_beside_itself() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PICTURES], capture_output=True, text=True, check=True, timeout=60
    )
    per_voxel, share = map(float, done.stdout.split())
    assert 32 < per_voxel < 300  # the map itself is 32
    assert 0.9 < share < 2.5
