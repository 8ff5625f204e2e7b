"""The way through: from finished VDB files to a look layer and a stage to open."""

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pxr import Sdf, Tf, Usd

from usdsmoke.base.errors import LayerError, WriteFailed
from usdsmoke.base.naming import COLOUR_VECTORS, EMISSION, ORIGINAL, VARIANT_SET
from usdsmoke.base.publish import publish_file
from usdsmoke.base.record_format import RunRecord, hash_stream
from usdsmoke.base.time_codes import format_time_codes, name_time_codes
from usdsmoke.base.volume import EarlierLooks, StageSource
from usdsmoke.config.run_sections import LayerConfig
from usdsmoke.usd.diagnostics import captured_diagnostics, readable_values, short_reason
from usdsmoke.usd.layer_record import add_digests, put_record, record_values
from usdsmoke.usd.look.attributes import author_attributes
from usdsmoke.usd.look.checks import check_root_file
from usdsmoke.usd.look.extent import author_extent
from usdsmoke.usd.look.fields import (
    author_field,
    choose_field_prims,
    close_fields,
    count_field_uses,
    retarget,
)
from usdsmoke.usd.look.material import author_material, keep_binding
from usdsmoke.usd.look.records import LookFiles, StylizedVolume, look_files, shader_name
from usdsmoke.usd.look.root import author_asset, author_root, copy_stage_metadata
from usdsmoke.usd.look.storm_shader import storm_shader
from usdsmoke.usd.materials import binds_material


@readable_values()
def author_look(
    stage: Usd.Stage,
    source: StageSource,
    volumes: Sequence[StylizedVolume],
    output_folder: Path,
    config: LayerConfig,
    record: RunRecord,
    earlier: EarlierLooks | None = None,
) -> LookFiles:
    """Write the look layer and then the root layer, both checked and each in one step.

    Before them comes the shader that a material of the layer needs.

    Call it last of all: the files it refers to have to be in place. Nothing of the source is
    changed, neither on disk nor in memory.

    Args:
        stage: the source, as ``open_stage`` gave it; read only.
        volumes: the results, one for each Volume that was stylized.
        output_folder: an existing folder; asset paths are relative to it.
        record: of the run, with the hashes of the results (``result_hashes``).
        earlier: looks that the stage's files still have and that this one takes the place of.

    Raises:
        LayerError: no result was given, a result does not fit its source, the source has no file,
            a target is one of the source's own layers, or somebody has added to the root layer.
        WriteFailed: a file could not be written or came back different.
    """
    folder = Path(output_folder).absolute()
    files = look_files(source.file_path, folder, config)
    _check_volumes(volumes)
    _check_targets(stage, files)
    check_root_file(files, config.mode, Path(source.file_path))  # edited while the run went on
    look = _author_look_layer(stage, volumes, folder, config, record, earlier or EarlierLooks())
    for name, text in _shaders(volumes, config).items():
        files = replace(files, shader=folder / name)
        publish_file(folder / name, text)
    _publish(look, files.look_layer)
    if files.root_stage is not None:
        if config.mode == "reference":
            root = author_asset(stage, config.look, files.look_layer, folder)
        else:
            root = author_root(stage, files.look_layer, folder)
        _publish(root, files.root_stage)
    return files


def shader_hashes(volumes: Sequence[StylizedVolume], config: LayerConfig) -> dict[str, str]:
    """SHA-256 of the shader that ``author_look`` writes, by its file name; empty for none."""
    return {
        name: hash_stream(io.BytesIO(text.encode()))
        for name, text in _shaders(volumes, config).items()
    }


def _shaders(volumes: Sequence[StylizedVolume], config: LayerConfig) -> dict[str, str]:
    """The text of the shader that a material of the look needs, by its file name."""
    binds = any(_binds(volume, config) for volume in volumes)
    if not binds or "glslfx" not in config.material_targets:
        return {}
    emits = any(EMISSION in volume.grids for volume in volumes)
    scatters = any(volume.scatter_field for volume in volumes)
    return {shader_name(config): storm_shader(emits, scatters)}


def _author_look_layer(
    stage: Usd.Stage,
    volumes: Sequence[StylizedVolume],
    folder: Path,
    config: LayerConfig,
    record: RunRecord,
    earlier: EarlierLooks,
) -> Sdf.Layer:
    layer = Sdf.Layer.CreateAnonymous(f".{config.format}")
    copy_stage_metadata(stage, layer, folder)
    names = ", ".join(f"<{volume.source.prim_path}>" for volume in volumes)
    layer.documentation = (
        f"Stylized smoke of {names}. Mute this layer to see the source; "
        "customLayerData.usdsmoke tells how it was made."
    )
    put_record(layer, record)
    uses = count_field_uses(stage)
    taken: set[Sdf.Path] = set()
    for volume in volumes:
        prim = stage.GetPrimAtPath(volume.source.prim_path)
        spec = Sdf.CreatePrimInLayer(layer, prim.GetPath())
        targets = choose_field_prims(stage, volume, uses, taken)
        author_attributes(spec, prim, volume, config.digital_source_type, record)
        author_extent(spec, prim, targets[0].beside, volume)
        for target in targets:
            author_field(layer, target, volume, folder)
            if target.is_new:
                retarget(spec, target)
        replaced = earlier.fields.get(volume.source.prim_path, ())
        close_fields(spec, [name for name in replaced if name not in volume.grids])
        if _binds(volume, config):
            author_material(spec, prim, volume, config)
        elif replaced:
            keep_binding(spec, prim)
    for path in earlier.variants:
        Sdf.CreatePrimInLayer(layer, path).variantSelections[VARIANT_SET] = ORIGINAL
    add_digests(layer)
    return layer


def _binds(volume: StylizedVolume, config: LayerConfig) -> bool:
    return binds_material(config, _has_colour(volume), volume.source.materials)


def _has_colour(volume: StylizedVolume) -> bool:
    return not set(COLOUR_VECTORS).isdisjoint(volume.grids)


def _check_volumes(volumes: Sequence[StylizedVolume]) -> None:
    if not volumes:
        raise LayerError("there is no stylized Volume to author. Pass at least one.")
    for volume in volumes:
        known = set(volume.source.time_codes)
        strange = sorted({frame.time_code for frame in volume.frames} - known)
        if strange or not volume.frames:
            found = f"frames at {name_time_codes(strange)}" if strange else "no frames"
            raise LayerError(
                f"the result of <{volume.source.prim_path}> has {found}. Pass frames at some of "
                f"the source's timeCodes {format_time_codes(known)}."
            )
        if volume.source.density not in volume.grids:
            raise LayerError(
                f"the result of <{volume.source.prim_path}> has no grid for its density "
                f'"{volume.source.density}" (found: {", ".join(volume.grids) or "none"}). Add it.'
            )


def _check_targets(stage: Usd.Stage, files: LookFiles) -> None:
    """Refuse to overwrite a layer of the source."""
    root = stage.GetRootLayer()
    if root.anonymous or not root.realPath:
        raise LayerError(
            f"the source stage {root.identifier} has no file that a layer could refer to. "
            "Save it first."
        )
    used = {Path(layer.realPath).resolve() for layer in stage.GetUsedLayers() if layer.realPath}
    for target in files.written:
        if target.resolve() in used:
            raise LayerError(
                f"{target} is a layer of the source stage itself. Choose another output folder."
            )


def _publish(layer: Sdf.Layer, target: Path) -> None:
    expected = layer.ExportToString()

    def write(temporary: Path) -> None:
        with captured_diagnostics():
            try:
                done = layer.Export(str(temporary))
            except Tf.ErrorException as error:
                raise WriteFailed(_failure(target, short_reason(error))) from None
        if not done:
            raise WriteFailed(_failure(target, "USD could not export it"))

    def check(temporary: Path) -> None:
        with captured_diagnostics():
            try:
                found = Sdf.Layer.OpenAsAnonymous(str(temporary)).ExportToString()
            except Tf.ErrorException as error:
                raise WriteFailed(_failure(target, short_reason(error))) from None
        if found != expected:
            raise WriteFailed(
                _failure(target, f"it read back as {len(found)} characters, not {len(expected)}")
            )

    publish_file(target, write, check)
    _refresh(target)


def _failure(target: Path, reason: str) -> str:
    return f"cannot write {target}: {reason}. Check the disk's space, or choose another folder."


def _refresh(target: Path) -> None:
    """Let stages of this process that have the old file open see the new one."""
    layer = Sdf.Layer.Find(str(target))
    if layer is not None and not layer.dirty:
        layer.Reload()


def published_runs(look_layer: Path) -> frozenset[str]:
    """The run ids that a look's layers name, .usda or .usdc; "" for a layer that names none.

    Args:
        look_layer: with either suffix; need not exist.
    """
    files = [look_layer.with_suffix(suffix) for suffix in (".usda", ".usdc")]
    return frozenset(_named_run(file_path) for file_path in files if file_path.exists())


def _named_run(look_layer: Path) -> str:
    try:
        with captured_diagnostics():
            layer = Sdf.Layer.OpenAsAnonymous(str(look_layer), metadataOnly=True)
    except Tf.ErrorException:
        return ""  # not a layer that usdsmoke has written
    return record_values(layer).get("run", "")
