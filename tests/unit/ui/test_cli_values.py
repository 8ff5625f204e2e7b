"""Texts of options that stand for numbers."""

import argparse

import pytest

from usdsmoke.ui.cli.values import duration_value


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("300s", 300), ("5min", 300), ("1h", 3600), ("90", 90), ("0.5 min", 30), ("2 H", 7200),
    ],
)  # fmt: skip
def test_durations(text: str, seconds: float) -> None:
    assert duration_value(text) == seconds


@pytest.mark.parametrize(
    "text", ["", "five", "5 days", "-3s", "0", "0.5s", "5m in", "30min1h", "1h30"]
)
def test_what_is_no_duration_is_refused_with_what_is(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="5min"):
        duration_value(text)
