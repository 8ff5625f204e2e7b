"""Stages as other programs and public repositories write them, from inspect to a checked result.

The files in ``foreign`` have the structure of exports of Houdini, Blender, Bifrost and Omniverse,
of tests of OpenUSD, Arnold, MoonRay and RenderMan, and of studios' shots; they are written anew.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from pxr import Usd

from tests.fixtures.pipeline_fixtures import Shot, make_style, run, stand_in
from tests.fixtures.preview_fixtures import pixels
from tests.fixtures.usd_fixtures import write_vdb
from usdsmoke import inspect
from usdsmoke.base.errors import UsdSmokeError
from usdsmoke.pictures.preview import preview
from usdsmoke.pipeline import plan as make_plan
from usdsmoke.usd.gate import validate_look

FOREIGN = Path(__file__).parent / "foreign"


@dataclass(frozen=True)
class Foreign:
    """A stage, its VDB files, and what usdsmoke makes of it."""

    files: Mapping[str, Sequence[str]]  # names of grids by path
    volumes: Mapping[str, Sequence[float]]  # timeCodes by path
    settings: Sequence[str] = ()
    layers: Sequence[str] = ()  # beside the stage
    says: Sequence[str] = ()  # parts of notes and omissions of the plan
    finds: Sequence[str] = ()  # rules that the look breaks


def _numbered(pattern: str, numbers: Sequence[int], *grids: str) -> dict[str, Sequence[str]]:
    return {pattern.format(number): grids or ("density",) for number in numbers}


STAGES = {
    # OpenUSD's guide: no stage metadata
    "wisp": Foreign(_numbered("wisp_01.{}.vdb", (101, 102, 103)), {"/wisp": (101, 102, 103)}),
    # OpenUSD's guide: a relationship that is custom, to a material that is not there
    "custom_relation": Foreign({"plume.vdb": ("density",)}, {"/Plume": (1,)}),
    # MoonRay: no MaterialBindingAPI, a material of one renderer
    "moonray": Foreign(
        {"bunny.vdb": ("density",)}, {"/Bunny": (1,)}, finds=("LookHidden",),
        says=("</Cloud> reads no emission",),
    ),
    # a digital twin: uniform attributes, paths without ./
    "airflow": Foreign(
        _numbered("frames/airflow.{}.vdb", (1001, 1002)), {"/sim/airflow_load_50": (1001, 1002)},
    ),
    # Omniverse and IndeX: the field is called fog
    "index_colormap": Foreign(
        {"torus.vdb": ("torus_fog",)}, {"/World/Volume": (1,)}, ("stage.density=fog",),
        finds=("LookHidden",),
    ),
    # OpenFOAM: a temperature alone
    "openfoam": Foreign(
        {"plume_0040.vdb": ("temperature",)}, {"/plume": (1,)}, ("stage.density=temperature",),
    ),
    # two Volumes of one name that show one file
    "two_below_xforms": Foreign(
        {"smoke.vdb": ("density",)}, {"/World/Near/Volume": (1,), "/World/Far/Volume": (1,)},
    ),
    # a field "vel" whose file has the components apart
    "wind_components": Foreign(
        {"puff.vdb": ("density", "vel.x", "vel.y", "vel.z")}, {"/puff": (1,), "/turned": (1,)},
        says=("field wind of </puff>",), finds=("MixedFilesPerVolume",),
    ),
    # Houdini Solaris: fieldIndex counts the grids, a Karma material
    "solaris": Foreign(
        _numbered("../cache/pyro.{}.vdb", (1001, 1002), "density", "flame", "temperature", "vel"),
        {"/pyro/volume_0": (1001, 1002)}, ("layer.copy_fields=[all]", "layer.material=replace"),
    ),
    # Blender: Z up, a dome light, flame and velocity
    "blender": Foreign(
        _numbered("volumes/smoke_000{}.vdb", (1, 2, 3), "density", "flame", "velocity"),
        {"/root/Smoke_Domain/Smoke_Domain": (1, 2, 3)}, ("layer.copy_fields=[flame]",),
    ),
    # Maya and Bifrost: grids have other names than their relationships
    "bifrost": Foreign(
        {"aero.0101.vdb": ("voxel_fog_density", "voxel_temperature")}, {"/bifrost/aero": (1,)},
        ("layer.copy_fields=[all]",),
    ),
    # Arnold: every third frame, of which one is missing
    "arnold_sequence": Foreign(
        _numbered("fume.000{}.vdb", (2, 5)), {"/fume": (2, 5)},
        ("stage.allow_missing=true", "layer.material=replace"), says=("missing at timeCode 8",),
    ),
    # Arnold: a prototype
    "arnold_instancer": Foreign(
        {"cloud.vdb": ("density",)}, {"/clouds/proto/cloud": (1,)}, says=("PointInstancer",),
    ),
    # a public cloud, as an asset with resolutions
    "cloud_resolutions": Foreign(
        {"wdas_cloud_half.vdb": ("density",), "wdas_cloud_quarter.vdb": ("density",)},
        {"/wdas_cloud": (1,)},
    ),
    # Storm's tests: one field prim of two Volumes, beside them
    "shared_fields": Foreign(
        {"smoke.vdb": ("density",)}, {"/views/left": (1,), "/views/right": (1,)},
        says=("stands elsewhere than its Volume </views/right>",),
    ),
    # an asset with a payload: a proxy beside what is rendered
    "asset_payload": Foreign(
        {"low.vdb": ("density",), "high.0000.vdb": ("density",), "high.0001.vdb": ("density",)},
        {"/chimney/fx/smoke_render": (0, 1)}, layers=("asset_payload_geo",),
        says=("</chimney/fx/smoke_proxy>: its purpose is proxy",),
    ),
    # a shot: a layer with an offset, a transform above, a velocity called v
    "shot_sublayers": Foreign(
        _numbered("smoke.000{}.vdb", (1, 2), "density", "vel"), {"/shot/fx/smoke": (1001, 1002)},
        layers=("shot_fx",),
    ),
    "value_clips": Foreign(
        _numbered("smoke.000{}.vdb", (1, 2)), {"/smoke": (1, 2)},
        layers=("clip_1", "clip_2", "clip_manifest"),
    ),
    # RenderMan: a material above that no binding can replace
    "renderman": Foreign(
        {"jet.vdb": ("density", "temperature")}, {"/steam/jet": (1,)},
        ("layer.copy_fields=[temperature]", "layer.material=replace"),
        says=("stronger than any on the Volume",), finds=("LookHidden",),
    ),
}  # fmt: skip

REFUSED = {
    "nurec": "OmniNuRecFieldAsset.*OpenVDB",
    "houdini_volumes": r"HoudiniFieldAsset\. .*convert the volume to \.vdb",
    "field3d": r"Field3DAsset\. .*convert the volume to \.vdb",
    "published_cache": r"no/such/mount.*no such file\. Check the path",
    "houdini_pattern": r"\$F4.*no frame patterns\. .*usdsmoke stage",
    "index_colormap": r"--set stage\.density=fog",
    "openfoam": r"--set stage\.density=temperature",
}


# with a look, emission is another field; it is not the density
NAMED = {"index_colormap": "fog", "openfoam": "temperature"}


def foreign_shot(folder: Path, name: str, files: Mapping[str, Sequence[str]] = {}) -> Shot:
    inputs = folder / "in"
    inputs.mkdir()
    for layer in (name, *(STAGES[name].layers if name in STAGES else ())):
        shutil.copy(FOREIGN / f"{layer}.usda", inputs)
    for number, (file_path, grids) in enumerate(files.items()):
        write_vdb(inputs / file_path, grids, value=0.5 + number / 8)
    style = make_style(inputs / "style.png")
    return Shot(folder, inputs / f"{name}.usda", style, folder / "out")


@pytest.mark.usefixtures("quick_grids")
@pytest.mark.parametrize("name", STAGES)
def test_a_foreign_stage_is_read_stylized_and_its_look_stands_the_gate(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    expected = STAGES[name]
    shot = foreign_shot(tmp_path, name, expected.files)
    seen = inspect(shot.stage, settings=expected.settings)
    found = {volume["prim_path"]: tuple(volume["time_codes"]) for volume in seen["volumes"]}
    assert found == expected.volumes

    with pytest.MonkeyPatch.context() as patch:
        stand_in(patch)
        result = run(shot, *expected.settings)
    assert len(result.frames) == sum(map(len, expected.volumes.values()))
    told = [*result.plan.warnings, *result.plan.notes]
    told += [f"{item.what}: {item.reason}" for item in result.plan.omitted]
    for part in expected.says:
        assert any(part in text for text in told), told

    own, _ = validate_look(result.root_stage)
    assert {finding.rule for finding in own} == set(expected.finds), own
    stage = Usd.Stage.Open(str(result.root_stage))
    for path, codes in expected.volumes.items():
        field = f"field:{result.plan.config.stage.density}"
        (density,) = stage.GetPrimAtPath(path).GetRelationship(field).GetTargets()
        shown = stage.GetPrimAtPath(density).GetAttribute("filePath").Get(codes[0])
        assert Path(shown.resolvedPath).is_relative_to(shot.output)
    if name in NAMED:
        with pytest.raises(UsdSmokeError, match=rf"--set stage\.density={NAMED[name]}\."):
            preview(result.root_stage, tmp_path / "a.png")
    selected = [text for text in expected.settings if text.startswith("stage.")]
    drawn = preview(
        result.root_stage, tmp_path / "a.png", width=32, settings=selected,
        frames=f"{max(codes):g}", allow_missing=True,
    )  # fmt: skip
    assert set(drawn.extinctions) == set(expected.volumes)
    assert pixels(tmp_path / "a.png").std() > 0.01  # there is something on the ground
    printed = capfd.readouterr()
    assert "Warning" not in printed.err + printed.out  # nothing of OpenUSD's own


@pytest.mark.parametrize("name", REFUSED)
def test_a_stage_without_smoke_that_can_be_read_is_refused_with_the_way_out(
    tmp_path: Path, name: str
) -> None:
    shot = foreign_shot(tmp_path, name, STAGES[name].files if name in STAGES else {})
    with pytest.raises(UsdSmokeError, match=REFUSED[name]):
        inspect(shot.stage)
    with pytest.raises(UsdSmokeError, match=REFUSED[name]):
        make_plan(shot.stage, shot.style, shot.output)
