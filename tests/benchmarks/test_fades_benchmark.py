"""``benchmarks.fades`` on few voxels."""

import pytest

from benchmarks import fades

QUICK = ["optimize.iterations=3", "views.pool=2", "views.image_size=16"]


def test_the_table_has_a_row_for_every_course_of_strengths(
    capsys: pytest.CaptureFixture[str],
) -> None:
    options = [word for setting in QUICK for word in ("--set", setting)]
    fades.main(["--resolution", "12", "--frames", "8", *options])
    rows = capsys.readouterr().out.splitlines()[2:]
    assert len(rows) == len(fades.STRENGTHS)
    cells = {row.split(" | ")[0].strip("| "): row.strip("| ").split(" | ")[1:] for row in rows}
    n_steps = {name: int(values[0]) for name, values in cells.items()}
    # what is computed beside visible frames goes on with the chain; frame 5 between 4 and 6 is not
    assert n_steps["1 throughout"] == n_steps["1, but 0 at frame 5"] == 7
    assert n_steps["1, but 0 at frames 4 to 6"] < 7
    for values in cells.values():
        mean, largest = float(values[1]), float(values[2])
        assert 0 < mean <= largest
