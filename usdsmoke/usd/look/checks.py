"""What is refused before anything is computed: files that a result would replace or not find."""

import os
from contextlib import suppress
from pathlib import Path

from pxr import Ar, Sdf, Tf, Usd

from usdsmoke.base.errors import LayerError
from usdsmoke.base.naming import ASSET_SOURCE
from usdsmoke.usd.diagnostics import captured_diagnostics
from usdsmoke.usd.look.records import LookFiles


def check_root_file(files: LookFiles, mode: str, source_file: Path) -> None:
    """Refuse to replace what somebody else has written, or has added to a root layer.

    Args:
        files: that will be written.
        mode: ``layer.mode``.
        source_file: the root layer of the source.

    Raises:
        LayerError: there is an asset of another source, a root layer with more than usdsmoke has
            written, or a file of another program.
    """
    if files.root_stage is None or not files.root_stage.exists():
        return
    if mode == "reference":
        _check_asset(files.root_stage, source_file)
    else:
        _check_root(files.root_stage, files.look_layer)


def _check_asset(file_path: Path, source_file: Path) -> None:
    """Refuse an asset of another source, or a file that is none."""
    theirs = ""
    with suppress(Tf.ErrorException), captured_diagnostics():
        layer = Sdf.Layer.OpenAsAnonymous(str(file_path), metadataOnly=True)
        theirs = str(layer.customLayerData.get(ASSET_SOURCE, "")) if layer else ""
    if theirs and (file_path.parent / theirs).resolve() == source_file.resolve():
        return
    found = f"holds the looks of {theirs}" if theirs else "is not an asset of usdsmoke"
    raise LayerError(
        f"{file_path} {found}, and would be replaced. Choose another output folder, or --mode "
        "sublayer."
    )


def _check_root(file_path: Path, look_layer: Path) -> None:
    """Refuse a root layer to which somebody has added something, or a file that is none."""
    found = "is not a layer"
    with suppress(Tf.ErrorException), captured_diagnostics():
        layer = Sdf.Layer.OpenAsAnonymous(str(file_path))
        if layer is not None and not layer.rootPrims and _has_two_sublayers(layer, look_layer):
            return
        found = "has prims or sublayers that usdsmoke did not write"
    raise LayerError(
        f"{file_path} {found}, and would be replaced. Move it away, and give a layer of your own "
        f"{file_path.name} as a sublayer; or choose another output folder."
    )


def _has_two_sublayers(layer: Sdf.Layer, look_layer: Path) -> bool:
    """Whether there are the look, in either format, and what it is laid over."""
    paths = list(layer.subLayerPaths)
    return len(paths) == 2 and Path(paths[0]).with_suffix("") == Path(look_layer.stem)


def check_search_paths(stage: Usd.Stage, root_file: Path) -> None:
    """Refuse a place for the root layer from which layers of the source are not found.

    USD's default resolver follows search paths from the folder of a stage's root layer, too.

    Args:
        stage: the source.
        root_file: the root layer or asset that will be written.

    Raises:
        LayerError: a layer of the source is found by a search path that leads elsewhere from there.
    """
    there = Ar.GetResolver().CreateDefaultContextForAsset(str(root_file))
    folder = Path(stage.GetRootLayer().realPath).parent
    own = _found_from(folder, stage.GetPathResolverContext(), stage)
    moved = _found_from(root_file.parent, there, stage)
    lost = sorted(key[1] for key, found in own.items() if found and moved[key] != found)
    if not lost:
        return
    raise LayerError(
        f"from {root_file.parent} the search path {lost[0]} of the source does not lead to "
        f"the same layer ({len(lost)} such). Set PXR_AR_DEFAULT_SEARCH_PATH={folder} wherever the "
        f"result is made and opened, take {folder} as the output folder, or write the look layer "
        "alone (--mode layer)."
    )


def _found_from(
    folder: Path, context: Ar.ResolverContext, stage: Usd.Stage
) -> dict[tuple[str, str], str]:
    """Where sublayers, references and payloads lead, by layer and authored path; "" for nowhere.

    What is found from this process's working directory alone does not count: the next process may
    have another one.

    Args:
        folder: of the root layer.
        context: of the stage that it opens.
    """
    resolver, found = Ar.GetResolver(), dict[tuple[str, str], str]()
    searched = os.environ.get("PXR_AR_DEFAULT_SEARCH_PATH", "").split(os.pathsep)
    bases = [folder, *(Path(base) for base in searched if base)]
    with Ar.ResolverContextBinder(context):
        for layer in stage.GetUsedLayers():
            for name in layer.GetCompositionAssetDependencies():
                identifier = resolver.CreateIdentifier(name, layer.resolvedPath)
                place = str(resolver.Resolve(identifier))
                if place and not os.path.isabs(identifier) and os.path.exists(identifier):
                    places = [str(base / identifier) for base in bases]
                    place = next(filter(os.path.exists, places), "")
                found[layer.identifier, name] = os.path.realpath(place) if place else ""
    return found
