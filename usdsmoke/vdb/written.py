"""Whether a file that usdsmoke wrote still holds the grids that a record promises."""

import math
import os
import threading
from contextlib import nullcontext
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

from usdsmoke.base.errors import BindingMissing, GridError, StageError
from usdsmoke.base.machine import GIB, available_memory_gib
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb.content_hash import CONTENT_KEY, hash_vdb_file
from usdsmoke.vdb.header import COMPONENTS, GridHeader, read_header

FILES_AT_ONCE = max(1, min(4, os.cpu_count() or 1))  # threads that compare a file each
_large_one = threading.Lock()  # one large file is in memory at a time
_MOST_GIB = 2.0**12  # where the system does not tell how much memory there is
_MOST_SECONDS = 3600.0


class State(Enum):
    """What became of a file."""

    INTACT = "intact"
    MISSING = "missing"
    FOREIGN = "foreign"  # another program wrote it
    OTHER = "other"  # usdsmoke wrote it, with other grids
    CHANGED = "changed"  # its grids are not those that it promises
    UNREADABLE = "unreadable"
    UNCHECKED = "unchecked"  # not compared: no OpenVDB, or not enough memory here


@dataclass(frozen=True)
class Written:
    """A file, compared with a record."""

    state: State
    found: str = ""  # the hash that was found, or why there is none


def compare_written(file_path: str | os.PathLike[str], recorded: str) -> Written:
    """Compare a file with the hash of its grids in a record."""
    path = os.fspath(file_path)
    if not os.path.isfile(path):
        return Written(State.MISSING)
    try:
        promised = str(read_header(path).metadata.get(CONTENT_KEY, ""))
        if promised != recorded:
            return Written(State.OTHER if promised else State.FOREIGN, promised)
        status = os.stat(path)
        found = _hash_once(path, status.st_mtime_ns, status.st_size)
    except BindingMissing as error:
        return Written(State.UNCHECKED, str(error))
    except (GridError, StageError, ArithmeticError, OSError) as error:
        if isinstance(error, GridError) and error.lacks_memory:
            return Written(State.UNCHECKED, "its grids need more memory than is free here")
        return Written(State.UNREADABLE, str(error))
    return Written(State.INTACT if found == recorded else State.CHANGED, found)


@lru_cache(maxsize=4096)
def _hash_once(file_path: str, _modified: int, _size: int) -> str:
    limits = _limits()
    needed = sum(_dense_gib(grid) for grid in read_header(file_path).grids)
    is_large = needed > limits.memory_limit_gib / FILES_AT_ONCE
    with _large_one if is_large else nullcontext():
        return hash_vdb_file(file_path, limits)


def _dense_gib(grid: GridHeader) -> float:
    return 4 * COMPONENTS.get(grid.value_type, 1) * math.prod(grid.box_shape or (0,)) / GIB


def _limits() -> GridsConfig:
    """Generous ones: the file promises what was recorded, and its run may have raised its own."""
    memory = min(max(available_memory_gib(), GridsConfig().memory_limit_gib), _MOST_GIB)
    return GridsConfig(memory_limit_gib=memory, time_limit_s=_MOST_SECONDS)
