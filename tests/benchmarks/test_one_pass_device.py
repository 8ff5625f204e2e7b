"""The comparison of devices: ways, voxels and colours of a small box."""

import pytest

from benchmarks import one_pass_device


def test_each_way_is_timed_and_the_network_alone_is_the_fastest(
    capsys: pytest.CaptureFixture[str],
) -> None:
    small = ["--box", "12", "14", "12", "--views", "2", "--iterations", "2", "2", "2"]
    small += ["--training", "2"]
    assert one_pass_device.main(small) == 0
    page = capsys.readouterr().out
    rows = [line.split("|") for line in page.splitlines() if "| cpu |" in line]
    seconds = {row[3].strip(): float(row[4]) for row in rows}
    assert list(seconds) == ["network", "network + 32", "noise, 6 iterations", "whole frame"]
    assert seconds["network"] < seconds["network + 32"]
    voxels = {row[3].strip(): int(row[2].replace(",", "")) for row in rows}
    assert voxels["whole frame"] < voxels["network"] / 2
    losses = {row[3].strip(): float(row[6]) for row in rows}
    assert losses["network + 32"] < losses["noise, 6 iterations"] < losses["network"]
    assert "2 iterations on 2 plumes" in page
