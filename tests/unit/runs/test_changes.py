"""What is named as different between two runs."""

from usdsmoke.runs.changes import find_changes

PIECES = ("timeCodes", "fields", "places", "cameras", "controls", "otherFields")


def words(changed: tuple[str, ...]) -> str:
    then = {name: "a" for name in PIECES}
    now = then | {name: "b" for name in changed}
    return str(find_changes({"stage": {"</v>": then}}, {"stage": {"</v>": now}}))


def test_every_piece_that_differs_is_named() -> None:
    found = words(("places", "cameras"))
    assert "transform" in found and "camera" in found
    assert "timeCodes" not in found and "fields" not in found


def test_with_other_timecodes_only_these_are_named_and_what_does_not_depend_on_them() -> None:
    """Digests of the frames' values differ then, though no frame may have other values."""
    found = words(PIECES)
    assert "timeCodes" in found and "other fields" in found
    assert "camera" not in found and "transform" not in found and "animated" not in found
