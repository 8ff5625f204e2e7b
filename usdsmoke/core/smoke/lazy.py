"""A row of things that are made when they are first looked at, and kept."""

from collections.abc import Callable, Sequence
from typing import Generic, TypeVar, overload

__all__ = ["OnDemand"]

Item = TypeVar("Item")


class OnDemand(Sequence[Item], Generic[Item]):
    """``make(0)`` ... ``make(n - 1)``, each made at most once: a pool of views, say, few of which
    are drawn in a short optimisation.
    """

    def __init__(self, n: int, make: Callable[[int], Item]) -> None:
        self._n, self._make = n, make
        self._made: dict[int, Item] = {}

    def __len__(self) -> int:
        return self._n

    @overload
    def __getitem__(self, index: int) -> Item: ...

    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...

    def __getitem__(self, index: int | slice) -> Item | list[Item]:
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(self._n))]
        number = range(self._n)[index]  # raises for what there is not, counts from the end below 0
        if number not in self._made:
            self._made[number] = self._make(number)
        return self._made[number]
