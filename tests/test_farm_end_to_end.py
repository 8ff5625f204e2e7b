"""The real core on windows run one by one, backwards: the bits of one process."""

import numpy as np
import pytest

from tests.farm_fixtures import outcome
from tests.grids_fixtures import raw_grid, write_raw
from tests.pipeline_fixtures import copied, make_shot, values_of
from tests.test_end_to_end import QUICK, ball
from usdsmoke import stylize
from usdsmoke.pipeline import Request, assemble, run_window

SETTINGS = [*QUICK, "optimize.iterations=3", "windows.size=2", "windows.overlap=1"]


@pytest.mark.slow
def test_the_real_core_gives_the_same_bits_window_by_window(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    shot = make_shot(tmp_path_factory.mktemp("farm") / "shot", n_frames=3)
    for code in (1, 2, 3):
        write_raw(shot.stage.parent / f"cache/smoke.{code:04d}.vdb", raw_grid(ball(0.05 * code)))
    whole = copied(shot, "whole")
    expected = outcome(
        stylize(whole.stage, whole.style, whole.output, settings=SETTINGS).root_stage
    )
    for window in (1, 0):
        run_window(Request(shot.stage, shot.style, shot.output, SETTINGS), window)
    result = assemble(shot.output)
    assert outcome(result.root_stage) == expected
    (folder,) = shot.output.glob("vdb/*/parts")
    tail, head = (values_of(folder / f"000{k}/smoke.0003.vdb") for k in (0, 1))
    assert np.isfinite(tail).all() and tail.max() > 0 and head.max() > 0
    assert result.overlap_difference is not None
    assert 0 < result.overlap_difference["density"] < 1
