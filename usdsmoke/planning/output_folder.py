"""Checks of the output folder: it can hold the result, and no input is overwritten."""

import os
from collections.abc import Sequence
from pathlib import Path

from usdsmoke.base.errors import LayerError, WriteFailed
from usdsmoke.base.naming import find_look_layers, relative_asset_path

_CONTROL = "".join(map(chr, (*range(32), 127)))
_LONGEST_NAME = 230  # bytes: most file systems take 255, and a temporary name is longer by 22


def resolve_output(output: str | os.PathLike[str]) -> Path:
    """The output folder, absolute and without links.

    Paths in a result's files are relative to it, whichever link was used.

    Raises:
        LayerError: it is a file or would lie in one, or may not be read.
    """
    folder = Path(os.path.realpath(output))
    frames = folder / "vdb"
    try:
        for place in (folder, *folder.parents):
            if place.exists() and not place.is_dir():
                found = "is" if place == folder else f"would lie in {place}, which is"
                raise LayerError(
                    f"the output {output} {found} a file. Choose a new or existing folder."
                )
        if frames.exists() and not frames.is_dir():
            raise LayerError(
                f"{frames} is a file, and the result's frames go into a folder of this name. Move "
                "it away, or choose another output folder."
            )
        is_open = not folder.exists() or os.access(folder, os.R_OK | os.X_OK)
    except PermissionError:  # of a folder above it, or its own
        is_open = False
    if not is_open:
        raise LayerError(
            f"the folder {output} cannot be read. Change its permissions (read, write and "
            "search), or choose another output folder."
        )
    return folder


def check_characters(output: Path, stage: Path, style_files: Sequence[Path]) -> None:
    """Refuse paths that layers and records cannot hold.

    Args:
        output: the output folder, settled.
        stage, style_files: absolute.

    Raises:
        LayerError: with the path and its character.
    """
    parts = [(str(output), "\\"), (relative_asset_path(stage, output), "\\" + _CONTROL)]
    parts += [(str(file_path), "") for file_path in style_files]
    for name, refused in parts:
        found = [c for c in name if c in refused or "\ud800" <= c <= "\udfff"]
        if found:
            raise LayerError(
                f"the path {name!a} has the character {found[0]!a}, which USD or JSON "
                "files cannot hold. Rename the file or the folder."
            )


def link_notes(output: str | os.PathLike[str], folder: Path, source: Path) -> tuple[str, ...]:
    """A note where a result cannot be opened through the link that leads to its folder.

    USD follows relative paths from the name that a layer was opened by.

    Args:
        output: as it was given.
        folder: the same without links.
        source: the stage that the result refers to.
    """
    given = os.path.abspath(output)
    way = os.path.normpath(os.path.join(given, relative_asset_path(source, folder)))
    if given == str(folder) or os.path.exists(way):
        return ()
    return (
        f"{given} leads to {folder} by a link. Open the result in {folder}: through the link its "
        "relative paths do not find the source",
    )


def check_writable(output: Path) -> None:
    """Refuse an output folder in which this process may not make files.

    Raises:
        WriteFailed: the folder, or the nearest one above it that exists, may not be written to.
    """
    place = next(folder for folder in (output, *output.parents) if folder.exists())
    if not os.access(place, os.W_OK | os.X_OK):
        what = f"write to the folder {output}" if place == output else f"make the folder {output}"
        raise WriteFailed(
            f"cannot {what}: {place} is not writable. Change its permissions, or choose "
            "another output folder."
        )


def check_output_folder(
    output: Path, look: str, inputs: Sequence[Path], targets: Sequence[Path]
) -> None:
    """Refuse an output folder in which the run would overwrite or remove files that it reads.

    Args:
        output: the output folder, settled; need not exist.
        inputs: absolute.
        targets: files that will be written outside the folder of frames.

    Raises:
        LayerError: an input or a folder has the path of a file of the result, a file's name would
            be too long, or the look's name differs from another's in upper and lower case only.
            Without this check these errors would appear only after the computation.
    """
    _check_look_name(output, look)
    for target in targets:
        if target.is_dir():
            raise LayerError(
                f"{target} is a folder, and a file of the result has this path. Move it away, "
                "or choose another output folder or look."
            )
        length = len(os.fsencode(target.name))
        if length > _LONGEST_NAME:
            raise LayerError(
                f"the file {target.name[:24]}... of the result would have a name of {length} "
                f"bytes, more than {_LONGEST_NAME}. Shorten layer.look (--look), or the name of "
                "the stage's file or its Volumes."
            )
    frames = (output / "vdb").resolve()
    taken = {target.resolve() for target in targets}
    for file_path in inputs:
        resolved = file_path.resolve()
        if resolved in taken or frames in resolved.parents:
            raise LayerError(
                f"{file_path} is an input of this run and would be overwritten by the result. "
                f"Choose another output folder than {output}."
            )


def _check_look_name(output: Path, look: str) -> None:
    """Refuse a name that differs from another look's in upper and lower case only.

    Many file systems treat the two as one file.
    """
    for file_path in find_look_layers(output):
        other = file_path.stem.removeprefix("look").removeprefix("_")
        if other != look and other.casefold() == look.casefold():
            raise LayerError(
                f"{output} has a look {other!r}, which differs from {look!r} only in upper and "
                "lower case. Choose another name with layer.look (--look)."
            )
