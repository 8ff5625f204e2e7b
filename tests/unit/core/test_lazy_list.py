"""A row that is made as it is looked at."""

import pytest

from usdsmoke.core.smoke.memory import LazyList


def test_an_item_is_made_when_it_is_first_looked_at_and_only_once():
    made: list[int] = []

    def make(number: int) -> str:
        made.append(number)
        return f"item {number}"

    row = LazyList(4, make)
    assert len(row) == 4 and made == []
    assert [row[2], row[2], row[-2]] == ["item 2"] * 3 and made == [2]
    assert row[1:3] == ["item 1", "item 2"] and made == [2, 1]
    assert list(row) == [f"item {n}" for n in range(4)] and sorted(made) == [0, 1, 2, 3]


@pytest.mark.parametrize("number", [4, -5])
def test_what_there_is_not_is_an_index_error(number: int):
    with pytest.raises(IndexError):
        LazyList(4, str)[number]
