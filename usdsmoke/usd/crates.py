"""Crate files that are looked at by a process of its own before OpenUSD reads them in this one.

OpenUSD trusts what it reads: a few damaged bytes of a crate file (.usdc, .usd, .usdz) make it take
gigabytes, or loop. So a worker process reads all values of a stage's small crate files first, under
limits of memory and time, as it does with VDB files (``vdb.child``). Large files are trusted: they
may need that much.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf

from usdsmoke.base.errors import StageError
from usdsmoke.config.run_sections import GridsConfig
from usdsmoke.vdb import child

LARGE = 2**24  # bytes; larger files are not looked at
_LIMITS = GridsConfig(memory_limit_gib=2.5, time_limit_s=8.0)  # for a file below that
_MAGIC = (b"PXR-USDC", b"PK\x03\x04")  # a crate file, a package


def check_crates(file_path: str) -> list[Sdf.Layer]:
    """Look at the small crate files among a layer and all that it refers to, however indirectly.

    Returns:
        The layers that were opened on the way: they are not read again while somebody has them.

    Raises:
        StageError: a file makes OpenUSD take too much memory or time, or end.
    """
    layers, seen, to_do = list[Sdf.Layer](), set[str](), [file_path]
    while to_do:
        path = str(Ar.GetResolver().Resolve(to_do.pop())) or file_path
        if path in seen or Ar.IsPackageRelativePath(path):
            continue
        seen.add(path)
        if _is_small_crate(path):
            to_do += _ask(path)
        elif path.endswith((".usda", ".usd")):
            with suppress(Tf.ErrorException):  # whoever opens the stage says what is wrong
                if layer := Sdf.Layer.FindOrOpen(path):
                    layers.append(layer)
                    to_do += _references(layer)
    return layers


def _is_small_crate(path: str) -> bool:
    try:
        with open(path, "rb") as stream:
            return stream.read(8).startswith(_MAGIC) and os.path.getsize(path) <= LARGE
    except OSError:
        return False


def _ask(path: str) -> list[str]:
    request = {"action": f"{__name__}:probe", "reader": "OpenUSD", "file_path": path}
    try:
        references, _ = child.run_child(request, [], _LIMITS)
    except child.ChildFailure as failure:
        raise StageError(
            f"cannot read {path}: {failure}. The file is probably damaged. Export it again."
        ) from None
    return list(references)


def probe(request: Mapping[str, Any], folder: Path) -> tuple[Any, int]:
    """The worker's side: reads all values of a layer; answers with the files it refers to.

    OpenUSD itself catches the end of the memory, so any value that it cannot read counts.

    Raises:
        ValueError: the layer, or one of its values, cannot be read.
    """
    try:
        layer = Sdf.Layer.FindOrOpen(request["file_path"])
        if not layer:
            raise ValueError("it is not a valid file")
        layer.Traverse(Sdf.Path.absoluteRootPath, lambda path: _read_values(layer, path))
    except Tf.ErrorException as error:
        said = [str(getattr(item, "commentary", item)) for item in error.args[:1]]
        raise ValueError(*said) from None
    return _references(layer), 0


def _read_values(layer: Sdf.Layer, path: Sdf.Path) -> None:
    with suppress(UnicodeDecodeError, TypeError, ValueError):  # of Python, not of the file
        spec = layer.GetObjectAtPath(path)
        for key in spec.ListInfoKeys() if spec else ():
            with suppress(UnicodeDecodeError, TypeError, ValueError):
                spec.GetInfo(key)


def _references(layer: Sdf.Layer) -> list[str]:
    """The layers that a layer refers to, as paths from here."""
    return list(_anchored(layer))


def _anchored(layer: Sdf.Layer) -> Iterator[str]:
    for asset in layer.GetCompositionAssetDependencies():
        with suppress(Tf.ErrorException, UnicodeDecodeError):
            if asset:
                yield Sdf.ComputeAssetPathRelativeToLayer(layer, asset)
