"""What is told of a frame's fields that were repaired."""

import dataclasses

import pytest

from tests.fixtures.smoke_fixtures import frame_of, puff
from tests.fixtures.stylize_fixtures import quick_config, run_core


@pytest.mark.parametrize(("count", "least"), [(1, "1 or more"), (2345, "1,000 or more")])
def test_replaced_numbers_are_told(count: int, least: str) -> None:
    frame = frame_of(puff(8))
    frame = dataclasses.replace(frame, density=dataclasses.replace(frame.density, repaired=count))
    (found,) = run_core([frame], quick_config())
    (told,) = [text for text in found.report.warnings if "repair_nan" in text]
    assert least in told and '"density"' in told


def test_nothing_is_told_of_fields_as_they_are() -> None:
    (found,) = run_core([frame_of(puff(8))], quick_config())
    assert not any("repair_nan" in text for text in found.report.warnings)
