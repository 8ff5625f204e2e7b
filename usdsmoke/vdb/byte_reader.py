"""Reading an untrusted file with every length checked before anything is allocated for it."""

import struct
from typing import Any, BinaryIO

from usdsmoke.base.errors import DamagedFile

_MAX_ITEMS = 65_536  # metadata entries or grids; real files have tens
_MAX_TEXT = 65_536  # bytes of a name or type
_MAX_BYTES = 33_554_432  # bytes of all headers together


class ByteReader:
    """Takes bytes from a file after checking that they are there and within the budget.

    Every method raises ``DamagedFile`` for impossible numbers; ``what`` names the part of the file
    in its message.
    """

    def __init__(self, stream: BinaryIO, size: int, where: str) -> None:
        """Start at byte 0 of a file of ``size`` bytes; ``where`` is its path, for messages."""
        self._stream = stream
        self._size = size
        self.position = 0
        self._budget = _MAX_BYTES
        self.where = where

    def damage(self, found: str) -> DamagedFile:
        """The error to raise when ``found`` shows that the file is damaged."""
        return DamagedFile(
            f"{self.where} is not a valid VDB file: {found}. Export or copy it again."
        )

    def seek(self, position: int, what: str) -> None:
        """Go to a byte of the file."""
        if not 0 <= position <= self._size:
            raise self.damage(
                f"{what} should be at byte {position}, but the file has {self._size} bytes"
            )
        self.position = position
        self._stream.seek(position)

    def skip(self, count: int, what: str) -> None:
        """Skip bytes without reading them."""
        self.seek(self.position + count, what)

    def take(self, count: int, what: str) -> bytes:
        """The next bytes."""
        left = self._size - self.position
        if count > left:
            raise self.damage(
                f"{what} should take {count} bytes at byte {self.position}, but {left} are left"
            )
        self._budget -= count
        if self._budget < 0:
            raise self.damage(f"its descriptions take more than {_MAX_BYTES} bytes")
        taken = self._stream.read(count)
        if len(taken) != count:  # the file shrank while it was read
            raise self.damage(f"it ends inside {what}")
        self.position += count
        return taken

    def unpack(self, layout: str, what: str) -> tuple[Any, ...]:
        """The next numbers, by a layout of ``struct``."""
        return struct.unpack(layout, self.take(struct.calcsize(layout), what))

    def text(self, what: str) -> str:
        """The next text, which is stored after its length."""
        (length,) = self.unpack("<I", what)
        if length > _MAX_TEXT:
            raise self.damage(f"{what} claims a length of {length} bytes")
        return self.take(length, what).decode("utf-8", errors="replace")

    def count(self, smallest: int, what: str) -> int:
        """A number of items that follow, each of at least ``smallest`` bytes."""
        (count,) = self.unpack("<I", what)
        left = self._size - self.position
        if count > _MAX_ITEMS or count * smallest > left:
            raise self.damage(f"it claims {count} {what}, with {left} bytes left")
        return int(count)
