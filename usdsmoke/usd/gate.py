"""Findings of a result as a gate needs them: the look's own apart from those of its source."""

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

from pxr import Ar, Sdf, Usd, UsdUtils, UsdVol

from usdsmoke.base.errors import OutputExists, UsdSmokeError, VolumeNotFound
from usdsmoke.base.naming import ORIGINAL, relative_asset_path
from usdsmoke.base.publish import publish_file
from usdsmoke.base.record_format import RunRecord
from usdsmoke.base.time_codes import name_time_codes
from usdsmoke.base.volume import StageSource
from usdsmoke.config.run_sections import StageConfig
from usdsmoke.usd.diagnostics import readable_values
from usdsmoke.usd.layer_record import read_record, record_values
from usdsmoke.usd.look import copy_stage_metadata
from usdsmoke.usd.rules import Finding, Severity, mend, switched_files, validate
from usdsmoke.usd.schema import LOOK_API
from usdsmoke.usd.stage import find_volumes, open_look, open_stage


def validate_look(
    stage: str | os.PathLike[str] | Usd.Stage,
) -> tuple[list[Finding], list[Finding]]:
    """The findings that a look is to blame for, and those that its source has without it.

    Rule, severity, prim and timeCode decide whether two findings are the same one, and the text of
    those of a whole stage. A finding on a file that only the look names is the look's: OpenUSD's
    validators follow muted layers too. USD does not mute layers in a package (.usdz); its source is
    what its root layer has beside looks. All findings are the look's where a package lies deeper.

    Args:
        stage: the root layer of a result, or any stage with looks.

    Raises:
        StageError: as of ``validate``; or the stage has no look.
    """
    composed = open_stage(stage)
    is_packed = _has_packed_look(composed)
    source = _packed_source(composed) if is_packed else open_look(stage, ORIGINAL)
    if _has_packed_look(source):
        return validate(stage), []
    known = {_what(finding) for finding in validate(source)}
    own_files = _files_named(composed) - _files_named(source)
    own, of_source = list[Finding](), list[Finding]()
    for finding in validate(stage):
        names_own = any(file in finding.message for file in own_files)
        is_known = _what(finding) in known and (finding.prim_path or not names_own)
        (of_source if is_known else own).append(finding)
    return [*_switched(source, composed), *_added(source, composed), *own], of_source


def short_looks(stage: str | os.PathLike[str]) -> list[Finding]:
    """Looks of a stage whose source has more timeCodes than it had when they were made.

    The stage without its looks tells, so this is no rule of a validator.
    """
    composed = open_stage(stage)
    if _has_packed_look(composed) or not any(map(record_values, composed.GetUsedLayers())):
        return []
    try:
        source = open_look(stage, ORIGINAL)
    except UsdSmokeError:
        return []  # a look layer by itself
    return _added(source, composed)


@readable_values()
def write_mends(stage_file: Path, target: Path) -> list[Finding]:
    """A new layer above a stage that mends what can be mended; not written if that is nothing.

    Returns:
        The findings that are gone on the new layer's stage.

    Raises:
        StageError: the stage cannot be opened or read, or OpenUSD has no fixers.
        OutputExists: there is such a file.
        WriteFailed: it cannot be written.
    """
    if target.exists():
        raise OutputExists(f"{target} exists. Give the name of a new layer.")
    source = open_stage(stage_file)
    layer = Sdf.Layer.CreateAnonymous(".usda")
    copy_stage_metadata(source, layer, target.absolute().parent)
    layer.subLayerPaths.append(relative_asset_path(stage_file, target.absolute().parent))
    publish_file(target, layer.ExportToString())
    mended = []
    try:
        mended = mend(open_stage(target))
    finally:
        if not mended:
            target.unlink()
    return mended


def fails(finding: Finding, strict: bool = False) -> bool:
    """Whether a gate does not let a stage with this finding pass.

    Args:
        strict: warnings fail too.
    """
    return finding.severity == Severity.ERROR or (strict and finding.severity == Severity.WARN)


def junit_xml(
    name: str, findings: Sequence[Finding], strict: bool = False, ignored: Iterable[str] = ()
) -> str:
    """Findings as JUnit XML, which CI servers show: one test case for each rule.

    Args:
        name: of the test suite, such as the stage's file name.
        findings: those that fail are failures; others are output of a case that passes.
        strict: see ``fails``.
        ignored: rules whose findings were left out; their cases are skipped.
    """
    rules, skipped = list(dict.fromkeys(finding.rule for finding in findings)), set(ignored)
    failed = {finding.rule for finding in findings if fails(finding, strict)}
    suite = ElementTree.Element(
        "testsuite",
        name=name,
        tests=str(max(len(rules) + len(skipped), 1)),
        failures=str(len(failed)),
        skipped=str(len(skipped)),
    )
    for rule in sorted(skipped):
        case = _case(suite, rule)
        ElementTree.SubElement(case, "skipped", message="left out by --ignore")
    for rule in rules or ([] if skipped else ["validate"]):
        case = _case(suite, rule)
        text = "\n".join(_line(finding) for finding in findings if finding.rule == rule)
        if rule in failed:
            ElementTree.SubElement(case, "failure", message=text.partition("\n")[0]).text = text
        elif text:
            ElementTree.SubElement(case, "system-out").text = text
    ElementTree.indent(suite)
    return ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"


def _case(suite: ElementTree.Element, rule: str) -> ElementTree.Element:
    return ElementTree.SubElement(suite, "testcase", classname="usdsmoke.validate", name=rule)


def _switched(source: Usd.Stage, composed: Usd.Stage) -> list[Finding]:
    """Volumes of the source that now show other files than their look was made from."""
    found = []
    for name in source.GetMutedLayers():
        layer = Sdf.Layer.FindOrOpen(name)
        if layer is None or not record_values(layer):
            continue
        try:
            record = read_record(layer)
            below = source
            if record.settings.get("stage", {}).get("restylize"):  # made from the looks below it
                below = _below(composed, layer)
            paths = dict.fromkeys(frame.prim for frame in record.frames)
            volumes = _volumes_of(record, paths, below)
        except UsdSmokeError:
            continue  # other rules report it
        at = partial(_time_on, composed, layer)
        for path, sentence in switched_files(record, Path(layer.realPath).parent, volumes, at):
            text = f"{sentence}. Stylize it again."
            found.append(Finding(Severity.ERROR, "LookStale", path, None, text))
    return found


def _below(composed: Usd.Stage, look: Sdf.Layer) -> Usd.Stage:
    """The stage without a look and those over it."""
    looks = [layer for layer in composed.GetLayerStack() if record_values(layer)]
    over = looks[: looks.index(look)] if look in looks else []
    stage = Usd.Stage.Open(composed.GetRootLayer(), composed.GetSessionLayer())
    for layer in (*over, look):
        stage.MuteLayer(layer.identifier)
    return stage


def _volumes_of(record: RunRecord, paths: Iterable[str], stage: Usd.Stage) -> StageSource:
    """Those of some Volumes that a stage has, found as a look's run has found them.

    Raises:
        UsdSmokeError: there is none, or one cannot be used.
    """
    prims = {path: stage.GetPrimAtPath(path) for path in paths}
    here = [path for path, prim in prims.items() if prim and prim.IsA(UsdVol.Volume)]
    if not here:
        raise VolumeNotFound("the stage has no Volume of the look. Select the variant that has it.")
    density = record.settings.get("stage", {}).get("density", "density")
    config = StageConfig(prims=here, density=density)
    return find_volumes(stage, config, with_requests=False, problems=[])


def _added(source: Usd.Stage, composed: Usd.Stage) -> list[Finding]:
    """Volumes with a look whose source has more timeCodes than it had when the look was made."""
    found = dict[str, Finding]()
    looks = [
        str(prim.GetPath())
        for prim in composed.Traverse()
        if LOOK_API in prim.GetPrimTypeInfo().GetAppliedAPISchemas()
    ]
    for layer in composed.GetUsedLayers():
        if not looks or not record_values(layer):
            continue
        try:
            record = read_record(layer)
            then, now = (
                {
                    volume.prim_path: set(volume.time_codes) if volume.animated else set()
                    for volume in _volumes_of(record, looks, stage).volumes
                }
                for stage in (composed, source)
            )
        except UsdSmokeError:
            continue  # other rules report it
        for path, codes in now.items():
            if path in then and (more := codes - then[path]):
                text = (
                    f"the source has {name_time_codes(sorted(more))} since the look was made, and "
                    "the look hides them. Make it longer, with more --frames."
                )
                found[path] = Finding(Severity.ERROR, "LookStale", path, None, text)
    return list(found.values())


def _time_on(stage: Usd.Stage, layer: Sdf.Layer, path: str, time_code: float) -> float:
    """The stage's timeCode at which a layer's timeCode is seen on a prim."""
    prim = stage.GetPrimAtPath(path)
    if not prim or not hasattr(prim, "GetPrimStackWithLayerOffsets"):
        return time_code
    pairs = prim.GetPrimStackWithLayerOffsets()
    offsets = [offset for spec, offset in pairs if spec.layer == layer]
    return float(offsets[0] * time_code) if offsets else time_code


def _has_packed_look(stage: Usd.Stage) -> bool:
    return any(_is_packed_look(layer) for layer in stage.GetUsedLayers())


def _is_packed_look(layer: Sdf.Layer) -> bool:
    return Ar.IsPackageRelativePath(layer.identifier) and bool(record_values(layer))


def _packed_source(composed: Usd.Stage) -> Usd.Stage:
    """The stage of a package without the looks among the sublayers of its root layer."""
    root, layer = composed.GetRootLayer(), Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(root)
    paths = [Sdf.ComputeAssetPathRelativeToLayer(root, path) for path in root.subLayerPaths]
    layers = {path: Sdf.Layer.FindOrOpen(path) for path in paths}
    layer.subLayerPaths = [
        path for path, found in layers.items() if found is None or not _is_packed_look(found)
    ]
    return Usd.Stage.Open(layer)


def _files_named(stage: Usd.Stage) -> set[str]:
    """Absolute paths that the layers in use name, those of sublayers aside."""
    muted, files = set(stage.GetMutedLayers()), set[str]()
    for layer in stage.GetUsedLayers():
        if layer.anonymous or layer.identifier in muted:
            continue
        _, references, payloads = UsdUtils.ExtractExternalReferences(layer.identifier)
        for path in (*references, *payloads):
            files.add(os.path.normpath(Sdf.ComputeAssetPathRelativeToLayer(layer, path)))
    return files


def _what(finding: Finding) -> tuple[object, ...]:
    text = "" if finding.prim_path else finding.message
    return finding.severity, finding.rule, finding.prim_path, finding.time_code, text


def _line(finding: Finding) -> str:
    where = f"<{finding.prim_path}> " if finding.prim_path else ""
    when = f"{name_time_codes([finding.time_code])} " if finding.time_code is not None else ""
    printable = "".join(c if c.isprintable() else " " for c in finding.message)  # XML 1.0
    return f"{finding.severity} {where}{when}{printable}"
