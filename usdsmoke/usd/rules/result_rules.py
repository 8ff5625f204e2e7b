"""Rules on files that usdsmoke wrote: they are unchanged since they were written."""

import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from pxr import Ar, Gf, Sdf, Usd, UsdVol

from usdsmoke.base.errors import GridError, LayerError, StageError
from usdsmoke.base.record_format import hash_file
from usdsmoke.usd.field_samples import FieldSamples, field_targets
from usdsmoke.usd.layer_record import LAYER_HASH, layer_digest, read_record, record_values
from usdsmoke.usd.rules.facts import Problem, Severity, collect_fields, grouped
from usdsmoke.usd.rules.staleness import rewritten_sources, switched_variants
from usdsmoke.usd.schema import LOOK_API
from usdsmoke.vdb.content_hash import CONTENT_KEY
from usdsmoke.vdb.header import read_header
from usdsmoke.vdb.written import FILES_AT_ONCE, State, compare_written

_REDO = "Redo its frame: the command that made it, with --frames."


def recorded_results(layer: Sdf.Layer) -> dict[str, str]:
    """Absolute path and content hash of every file that a look layer records.

    Raises:
        LayerError: the layer's record cannot be read.
    """
    if not record_values(layer):
        return {}
    results = read_record(layer).results
    return {
        Sdf.ComputeAssetPathRelativeToLayer(layer, path): digest for path, digest in results.items()
    }


def check_layer_results(layer: Sdf.Layer) -> list[Problem]:
    """The files of a look are there and hold what the layer recorded."""
    try:
        results = recorded_results(layer)
    except LayerError as error:
        return [Problem(Severity.ERROR, "", str(error))]
    packed = [path for path in results if Ar.IsPackageRelativePath(path)]
    if packed:
        package, _ = Ar.SplitPackageRelativePathOuter(packed[0])
        text = (
            f"the result's files lie inside the package {os.path.basename(package)}, and OpenVDB "
            "reads plain files only, so renderers find no smoke. Unpack it (a .usdz is a zip), and "
            "hand over the folder."
        )
        return [Problem(Severity.ERROR, "", text)]
    with ThreadPoolExecutor(max_workers=FILES_AT_ONCE) as pool:
        found = list(pool.map(_compare, results.keys(), results.values()))
    problems = [
        Problem(severity, "", f"{os.path.basename(file_path)} {trouble}")
        for file_path, (severity, trouble) in zip(results, found, strict=True)
        if trouble
    ]
    return [*problems, *_changed_shaders(layer), *_edited(layer)]


def _edited(layer: Sdf.Layer) -> list[Problem]:
    """A look layer that was edited; nothing where another OpenUSD wrote it, in another text."""
    values = record_values(layer)
    if not values.get(LAYER_HASH) or layer_digest(layer) == values[LAYER_HASH]:
        return []
    written_by = read_record(layer).packages.get("usd-core", "")
    major, minor = Usd.GetVersion()[1:]
    if written_by.split(".")[:2] != [str(major), str(minor)]:
        return []
    text = (
        "the look layer was edited after it was written, so its numbers may be wrong. Put edits "
        "into a layer above it"
    )
    return [Problem(Severity.WARN, "", f"{text}.")]


def _changed_shaders(layer: Sdf.Layer) -> list[Problem]:
    """Shaders beside a look layer whose text is another one; one that is missing USD reports."""
    problems = []
    for name, recorded in read_record(layer).shaders.items() if record_values(layer) else ():
        path = Sdf.ComputeAssetPathRelativeToLayer(layer, f"./{name}")
        if os.path.isfile(path) and hash_file(path) != recorded:
            text = (
                f"{name} was changed after it was written. Delete it and run 'usdsmoke assemble' "
                "to write it again."
            )
            problems.append(Problem(Severity.ERROR, "", text))
    return problems


def check_field_results(volume: Usd.Prim, interval: Gf.Interval) -> list[Problem]:
    """Files with a hash of ours hold what they were written with, also without their look layer."""
    problems = []
    seen: set[str] = set()
    for layer in volume.GetStage().GetUsedLayers():
        with suppress(LayerError):  # ``check_layer_results`` reports it
            seen |= recorded_results(layer).keys()
    for field in collect_fields(volume, interval):
        for sample in field.samples:
            if not os.path.isfile(sample.file_path) or sample.file_path in seen:
                continue
            seen.add(sample.file_path)
            promised = _promised(sample.file_path)
            severity, trouble = _compare(sample.file_path, promised) if promised else (None, "")
            if severity and trouble:
                message = f"{os.path.basename(sample.file_path)} {trouble}"
                problems += grouped(severity, field.prim_path, {sample.time_code: message})
    return problems


def check_stale(volume: Usd.Prim, _interval: Gf.Interval) -> list[Problem]:
    """Variants and source files are those that a look of the Volume was made from."""
    problems = []
    for spec in volume.GetPrimStack():
        if not record_values(spec.layer):
            continue
        try:
            record = read_record(spec.layer)
        except LayerError:
            continue  # ``check_layer_results`` reports it
        selected = {
            name: value
            for name in record.variants
            if (value := _selected_variant(volume, spec.path, name)) is not None
        }
        folder = Path(spec.layer.realPath).parent
        where = str(volume.GetPath())
        found = [(False, text) for text in switched_variants(record, selected)]
        found += rewritten_sources(record, folder, str(spec.path))
        problems += [
            Problem(Severity.INFO, where, f"{text}.")
            if is_same
            else Problem(Severity.ERROR, where, f"{text}. Stylize it again.")
            for is_same, text in found
        ]
    return problems


def check_volumes_of_looks(stage: Usd.Stage) -> list[Problem]:
    """The Volumes of the looks in a stage's own layers are on the stage and active.

    Where there is nothing but looks, or a payload above is not loaded, nothing is known of them.
    """
    stack = stage.GetLayerStack(includeSessionLayers=False)
    looks = [layer for layer in stack if record_values(layer)]
    others = [layer for layer in stack if layer not in looks and layer.rootPrims]
    problems = []
    for layer in looks if others else ():
        paths: list[Sdf.Path] = []
        layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
        for path in paths:
            spec = layer.GetPrimAtPath(path)
            schemas = spec.GetInfo("apiSchemas") if spec else None
            if not (schemas and LOOK_API in schemas.GetAppliedItems()):
                continue
            prim = stage.GetPrimAtPath(path)
            if prim and prim.IsActive() and prim.IsA(UsdVol.Volume):
                continue
            above = (stage.GetPrimAtPath(part) for part in path.GetPrefixes())
            if any(part and part.HasAuthoredPayloads() and not part.IsLoaded() for part in above):
                continue
            text = (
                f"{layer.GetDisplayName()} is a look of the Volume <{path}>, which the stage does "
                "not have. Select the variant that has it, activate it, or leave the look out."
            )
            problems.append(Problem(Severity.WARN, str(path) if prim else "/", text))
    return problems


def check_look_strongest(volume: Usd.Prim, _interval: Gf.Interval) -> list[Problem]:
    """The files that a look gives to the fields of a Volume are not replaced by a stronger layer.

    A stronger layer may name files of usdsmoke, such as the same ones at another place.
    """
    problems = []
    for path in sorted({p for targets in field_targets(volume).values() for p in targets}):
        prim = volume.GetStage().GetPrimAtPath(path)
        stack = prim.GetAttribute("filePath").GetPropertyStack() if prim else []
        stack = [spec for spec in stack if spec.HasInfo("default") or spec.HasInfo("timeSamples")]
        looks = [spec for spec in stack if record_values(spec.layer)]
        if not looks or stack[0] in looks:
            continue
        shown = FieldSamples(prim).inside(Gf.Interval.GetFullInterval())
        if any(_promised(sample.file_path) for sample in shown):
            continue
        stronger, look = (spec.layer.GetDisplayName() for spec in (stack[0], looks[0]))
        text = (
            f"{stronger} is stronger than the look layer {look} and sets filePath too, so the "
            "files of the look are not shown. Make the look layer the stronger one (it comes first "
            "in subLayers), or remove that opinion."
        )
        problems.append(Problem(Severity.ERROR, str(path), text))
    return problems


def _selected_variant(volume: Usd.Prim, spec_path: Sdf.Path, name: str) -> str | None:
    """What is selected now of a variant set ``</prim>{set}`` at or above a look's prim spec."""
    path, _, set_name = name.removeprefix("<").removesuffix("}").partition(">{")
    above = spec_path.pathElementCount - Sdf.Path(path).pathElementCount
    prim = volume
    for _ in range(above):
        prim = prim.GetParent() if prim else prim
    if above < 0 or not prim or prim.IsPseudoRoot():
        return None
    sets = prim.GetVariantSets()
    return sets.GetVariantSelection(set_name) if sets.HasVariantSet(set_name) else None


def _promised(file_path: str) -> str:
    try:
        return str(read_header(file_path).metadata.get(CONTENT_KEY, ""))
    except (GridError, StageError):
        return ""


def _compare(file_path: str, recorded: str) -> tuple[Severity, str]:
    """What is wrong with a file of ours; empty if it is unchanged."""
    written = compare_written(file_path, recorded)
    state, why = written.state, written.found
    if state == State.INTACT:
        return Severity.INFO, ""
    if state == State.UNCHECKED:
        return Severity.INFO, f"was not compared with its hash: {why}"
    trouble = {
        State.MISSING: f"is missing, but it belongs to the result. {_REDO}",
        State.FOREIGN: f"is no file of usdsmoke, and not that of this result. {_REDO}",
        State.OTHER: f"is another file of usdsmoke, and not that of this result. {_REDO}",
        State.UNREADABLE: f"cannot be compared with its hash: {why}",
        State.CHANGED: f"was changed after it was written. {_REDO}",
    }
    return Severity.ERROR, trouble[state]
