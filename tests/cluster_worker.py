"""Loaded by the Dask workers of a test: stand-ins for the core that take a moment for every frame.

Every frame that is begun leaves a line in the file that USDSMOKE_TEST_LOG names: process, timeCode.
"""

import os
import time

from tests.pipeline_fixtures import FakeCore, pose

FRAME_S = 0.1


def note_and_wait(time_code: float) -> None:
    """Take as long as a very small frame does."""
    with open(os.environ["USDSMOKE_TEST_LOG"], "a", encoding="utf-8") as stream:
        stream.write(f"{os.getpid()} {time_code}\n")
    time.sleep(FRAME_S)


core = FakeCore()
core.before_frame = note_and_wait
pose(core)
