"""Root layers that somebody has added to, and stages that are not seen as their files are."""

from dataclasses import replace
from pathlib import Path

import pytest
from pxr import Ar, Sdf, Usd, UsdGeom

from tests.fixtures.pipeline_fixtures import Shot, make_shot, make_style, run
from tests.fixtures.usd_fixtures import (
    HEADER,
    density_prim,
    file_hashes,
    make_look,
    plume_stage,
    sampled,
    sequence,
    volume_prim,
    world,
    write_sequence,
    write_text,
)
from usdsmoke.base.errors import LayerError, StageError
from usdsmoke.pipeline import plan
from usdsmoke.usd.gate import validate_look
from usdsmoke.usd.rules import validate

pytestmark = pytest.mark.usefixtures("core")


def add_camera(root_stage: Path) -> None:
    stage = Usd.Stage.Open(str(root_stage))
    UsdGeom.Camera.Define(stage, "/cameras/render")
    stage.GetRootLayer().Save()


def add_sublayer(root_stage: Path) -> None:
    layer = Sdf.Layer.FindOrOpen(str(root_stage))
    layer.subLayerPaths.insert(0, write_text(root_stage.parent / "light.usda", HEADER).name)
    layer.Save()


def another_layer(root_stage: Path) -> None:
    root_stage.write_text('#usda 1.0\ndef "lookdev" {\n}\n')


def no_layer(root_stage: Path) -> None:
    root_stage.write_bytes(b"somebody's")


@pytest.mark.parametrize("change", [add_camera, add_sublayer, another_layer, no_layer])
def test_what_somebody_has_put_into_a_root_layer_is_not_replaced(shot: Shot, change) -> None:
    root_stage = run(shot, "stage.frames=1").root_stage
    assert root_stage is not None
    change(root_stage)
    before = file_hashes(shot.output)
    with pytest.raises(LayerError, match=r"shot_look\.usda"):
        run(shot, "stage.frames=1-2")
    assert file_hashes(shot.output) == before


@pytest.mark.parametrize("layer_format", ["usda", "usdc"])
def test_a_root_layer_as_it_was_written_is_replaced(shot: Shot, layer_format: str) -> None:
    run(shot, "stage.frames=1")
    result = run(shot, "stage.frames=1-2", f"layer.format={layer_format}", force=True)
    assert len(result.frames) == 2


def nested_search_path(folder: Path) -> Shot:
    """The Volume comes from a layer that is found from the folder of the root layer alone."""
    write_sequence(folder / "in/lib", (1, 2))
    write_text(folder / "in/lib/smoke.usda", world(volume_prim(density_prim(sequence((1, 2))))))
    reference = '#usda 1.0\n(defaultPrim = "fx")\ndef "fx" (references = @{}@{}) {{\n}}\n'
    write_text(folder / "in/fx/asset.usda", reference.format("lib/smoke.usda", "</World>"))
    stage = write_text(folder / "in/shot.usda", reference.format("./fx/asset.usda", ""))
    return Shot(folder, stage, make_style(folder / "in/style.png"), folder / "out")


@pytest.mark.parametrize("folder", [".", "in"])
@pytest.mark.parametrize("mode", ["sublayer", "reference"])
def test_search_paths_that_a_result_would_not_find_are_refused(
    tmp_path: Path, mode: str, folder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shot = nested_search_path(tmp_path)
    monkeypatch.chdir(tmp_path / folder)  # USD looks there too
    with pytest.raises(LayerError, match=r"lib/smoke\.usda"):
        plan(shot.stage, shot.style, shot.output, [f"layer.mode={mode}"])
    assert plan(shot.stage, shot.style, shot.output, ["layer.mode=layer"]).n_frames == 2
    assert plan(shot.stage, shot.style, shot.stage.parent, [f"layer.mode={mode}"]).n_frames == 2


def test_stages_that_are_seen_otherwise_than_their_files_are_refused(tmp_path: Path) -> None:
    made = make_shot(tmp_path)
    payload = (
        '#usda 1.0\n(defaultPrim = "World")\ndef "World" (payload = @./shot.usda@</World>) {\n}\n'
    )
    shot = replace(made, stage=write_text(made.stage.parent / "loads.usda", payload))
    path = str(shot.stage)
    stages = {
        "population mask": Usd.Stage.OpenMasked(path, Usd.StagePopulationMask(["/World/smoke"])),
        "payloads": Usd.Stage.Open(path, Usd.Stage.LoadNone),
        "resolver context": Usd.Stage.Open(path, Ar.DefaultResolverContext([str(tmp_path)])),
    }
    for reason, stage in stages.items():
        with pytest.raises(StageError, match=reason):
            plan(stage, shot.style, shot.output)
    loaded = Usd.Stage.Open(path, Usd.Stage.LoadNone)
    loaded.Load()
    for stage in (Usd.Stage.Open(path), loaded):
        assert plan(stage, shot.style, shot.output).n_frames == 3


@pytest.mark.parametrize(
    ("relation", "visibility", "settings"),
    [
        ("density", "inherited", ()),
        ("soot", "inherited", ("stage.density=soot",)),
        ("density", "invisible", ("stage.prims=[/World/smoke]",)),
    ],
)
def test_other_files_and_more_time_codes_of_the_source_are_told(
    tmp_path: Path, relation: str, visibility: str, settings: tuple[str, ...]
) -> None:
    def write(folder: str, *codes: int) -> Path:
        write_sequence(tmp_path / f"in/{folder}", codes)
        files = density_prim(sequence(codes, f"./{folder}/cache/smoke.{{:04d}}.vdb"))
        relations = f"rel field:{relation} = </World/smoke/density>"
        body = f'token visibility = "{visibility}"\n{files}'
        return write_text(tmp_path / "in/shot.usda", world(volume_prim(body, "smoke", relations)))

    def found(root_stage: Path | None) -> list[str]:
        own, _ = validate_look(str(root_stage))
        return [item.message for item in own if item.rule == "LookStale"]

    shot = Shot(tmp_path, write("a", 1, 2), make_style(tmp_path / "in/style.png"), tmp_path / "out")
    result = run(shot, *settings)
    assert found(result.root_stage) == []
    write("b", 1, 2)
    assert "b/cache" in found(result.root_stage)[0]
    write("a", 1, 2, 3)
    assert "3" in found(result.root_stage)[0]


@pytest.mark.parametrize("mode", ["sublayer", "reference"])
def test_looks_under_another_path_and_without_their_volume_are_validated(
    tmp_path: Path, mode: str
) -> None:
    shot = make_shot(tmp_path, n_frames=2)
    result = run(shot, f"layer.mode={mode}")
    assert result.root_stage is not None
    reference = f'def "fx" (references = @{result.root_stage}@</World>) {{\n}}\n'
    above = write_text(tmp_path / "above.usda", f"#usda 1.0\n{reference}")

    def rules(stage: Path) -> set[tuple[str, str]]:
        return {(item.rule, item.prim_path) for item in validate_look(str(stage))[0]}

    assert "LookStale" not in {rule for rule, _ in rules(above)}
    write_sequence(shot.stage.parent, (3,))
    text = shot.stage.read_text()
    longer = text.replace(
        "2: @./cache/smoke.0002.vdb@", "2: @./cache/smoke.0002.vdb@, 3: @./cache/smoke.0003.vdb@"
    )
    assert longer != text
    shot.stage.write_text(longer)
    assert ("LookStale", "/fx/smoke") in rules(above)
    if mode == "sublayer":
        shot.stage.write_text(text.replace('def Volume "smoke"', 'def Volume "other"'))
        assert ("LookWithoutVolume", "/World/smoke") in rules(result.root_stage)


def test_units_of_a_look_are_those_at_its_first_time_code(tmp_path: Path) -> None:
    """The scale of the Volume's parent changes all along, from before the smoke is there."""
    stage_file = plume_stage(tmp_path, (5, 6))
    scale = sampled("float3 xformOp:scale", {0: "(1, 1, 1)", 10: "(2, 2, 2)"})
    order = 'uniform token[] xformOpOrder = ["xformOp:scale"]'
    head = 'def Xform "World"\n{'
    stage_file.write_text(stage_file.read_text().replace(head, f"{head}{scale}\n{order}\n"))
    root_stage = make_look(stage_file, tmp_path / "out").root_stage
    assert "LookUnits" not in {item.rule for item in validate(str(root_stage))}
    stage_file.write_text(stage_file.read_text().replace("(2, 2, 2)", "(8, 8, 8)"))
    assert "LookUnits" in {item.rule for item in validate(str(root_stage))}


def test_asset_paths_of_all_kinds_in_the_metadata_are_found_from_the_result(tmp_path: Path) -> None:
    stage_file = plume_stage(tmp_path / "in")
    colours = write_text(tmp_path / "in/ocio/config.ocio", "x")
    layer = Sdf.Layer.FindOrOpen(str(stage_file))
    layer.colorConfiguration = Sdf.AssetPath("ocio/config.ocio")
    several = Sdf.AssetPathArray([Sdf.AssetPath("./ocio/config.ocio")])
    layer.customLayerData = {"several": several, "one": Sdf.AssetPath("ocio/config.ocio")}
    layer.Save()
    root = Sdf.Layer.FindOrOpen(str(make_look(stage_file, tmp_path / "out").root_stage))
    data = root.customLayerData
    for asset in (root.colorConfiguration, data["one"], *data["several"]):
        assert Path(root.ComputeAbsolutePath(asset.path)).resolve() == colours.resolve()
