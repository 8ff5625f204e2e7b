"""Every refusal through the command: its message, its exit code, nothing left behind."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.fixtures.grids_fixtures import raw_grid, write_raw
from tests.fixtures.pipeline_fixtures import FakeCore, Shot, make_shot, run, values_of, write_nan
from tests.fixtures.usd_fixtures import (
    density_prim,
    file_hashes,
    volume_prim,
    world,
    write_text,
    write_vdb,
)
from usdsmoke.audit import provenance
from usdsmoke.base.errors import ConfigError, LayerError
from usdsmoke.pipeline import assemble, stylize
from usdsmoke.ui.cli.main import main

Spoil = Callable[[Shot], list[str]]  # makes a shot bad; further arguments of the command


def second_file(shot: Shot) -> Path:
    return shot.stage.parent / "cache/smoke.0002.vdb"


def level_set(shot: Shot) -> list[str]:
    write_vdb(second_file(shot), grid_class="level set")
    return []


def retyped(new: bytes) -> Spoil:
    """The second file's grid claims another type of values; the name has the same length."""

    def spoil(shot: Shot) -> list[str]:
        old = second_file(shot).read_bytes()
        second_file(shot).write_bytes(old.replace(b"Tree_float_5_4_3", new))
        assert second_file(shot).read_bytes() != old
        return []

    return spoil


def missing_file(shot: Shot) -> list[str]:
    second_file(shot).unlink()
    return []


def missing_grid(shot: Shot) -> list[str]:
    write_vdb(second_file(shot), names=("smoke", "heat"))
    return []


def not_finite(shot: Shot) -> list[str]:
    write_nan(second_file(shot))
    return []


def not_a_vdb(shot: Shot) -> list[str]:
    second_file(shot).write_bytes(b"\x89PNG and more")
    return []


def cut_off(shot: Shot) -> list[str]:
    content = second_file(shot).read_bytes()
    second_file(shot).write_bytes(content[: len(content) * 2 // 3])
    return []


def shows(file_path: str) -> Spoil:
    """A stage whose density is one file, spelt as given."""

    def spoil(shot: Shot) -> list[str]:
        shot.stage.write_text(world(volume_prim(density_prim(f"asset filePath = @{file_path}@"))))
        return []

    return spoil


def instanced(shot: Shot) -> list[str]:
    body = volume_prim(density_prim("asset filePath = @./cache/smoke.0001.vdb@"))
    write_text(shot.stage.parent / "asset.usda", world(body))
    reference = "instanceable = true\n prepend references = @./asset.usda@</World>"
    shot.stage.write_text(f'#usda 1.0\ndef Xform "Copy" (\n {reference}\n)\n{{\n}}\n')
    return ["--prim", "/Copy/smoke"]


def no_volume(shot: Shot) -> list[str]:
    shot.stage.write_text(world('def Sphere "ball" {}'))
    return []


def no_density(shot: Shot) -> list[str]:
    relation = "rel field:heat = </World/smoke/density>"
    prim = density_prim("asset filePath = @./cache/smoke.0001.vdb@")
    shot.stage.write_text(world(volume_prim(prim, relations=relation)))
    return []


def not_a_stage(shot: Shot) -> list[str]:
    shot.stage.write_text("no usd at all")
    return []


def not_an_image(shot: Shot) -> list[str]:
    shot.style.write_text("no image")
    return []


def no_image(shot: Shot) -> list[str]:
    shot.style.unlink()
    return []


def output_is_a_file(shot: Shot) -> list[str]:
    return ["-o", str(write_text(shot.folder / "in/notes.txt", "mine"))]


def output_lies_in_a_file(shot: Shot) -> list[str]:
    return ["-o", str(write_text(shot.folder / "in/notes.txt", "mine") / "q/r")]


def frames_folder_is_a_file(shot: Shot) -> list[str]:
    return ["-o", str(write_text(shot.folder / "in/mine/vdb", "mine").parent)]


def layer_is_a_folder(shot: Shot) -> list[str]:
    return ["-o", str(write_text(shot.folder / "in/mine/look.usda/notes.txt", "mine").parents[1])]


def with_arguments(*more: str) -> Spoil:
    return lambda shot: list(more)


REFUSALS: dict[str, tuple[Spoil, str, str]] = {
    "level set": (level_set, "UnsupportedGrid", "smoke.0002.vdb (field </World/smoke/density>, "
        "timeCode 2) is a level set"),
    "whole numbers": (retyped(b"Tree_int32_5_4_3"), "UnsupportedGrid", "holds int32 values"),
    "odd tree": (retyped(b"Tree_float_3_4_5"), "UnsupportedGrid", "3_4_5 tree"),
    "missing file": (missing_file, "AssetNotResolved", "smoke.0002.vdb"),
    "missing grid": (missing_grid, "GridNotFound", "smoke.0002.vdb (field </World/smoke/density>, "
        'timeCode 2) has no grid "density"; it has smoke, heat.'),
    "NaN": (not_finite, "NonFiniteError", "timeCode 2) has 2 NaN or infinite voxels"),
    "not a VDB": (not_a_vdb, "DamagedFile", "smoke.0002.vdb"),
    "cut off": (cut_off, "DamagedFile", "smoke.0002.vdb"),
    "package": (shows("./all.usdz[smoke.vdb]"), "AssetNotResolved", "is inside the package"),
    "Houdini path": (shows("op:/obj/pyro/out"), "AssetNotResolved", "node inside Houdini"),
    "empty path": (shows(""), "AssetNotResolved", "</World/smoke/density>"),
    "instance": (instanced, "StageError", "it is inside the instance </Copy>"),
    "no Volume": (no_volume, "VolumeNotFound", "no Volume on the stage"),
    "wrong prim": (with_arguments("--prim", "/World/fog"), "VolumeNotFound", "</World/smoke>"),
    "no density": (no_density, "FieldNotFound", "(found: field:heat)"),
    "wrong frames": (with_arguments("--frames", "7-9"), "StageError", "1-3"),
    "unread frames": (with_arguments("--frames", "1to4"), "ConfigError", "'1to4'"),
    "deep settings": (with_arguments("--set", f"views.pool={'[' * 2000}"), "ConfigError", "pool"),
    "not a stage": (not_a_stage, "StageError", "shot.usda"),
    "not an image": (not_an_image, "ImageError", "style.png"),
    "no image": (no_image, "ImageError", "style.png: No such file"),
    "no config": (with_arguments("--config", "no.yaml"), "ConfigError", "no.yaml"),
    "unknown setting": (with_arguments("--set", "windows.sise=3"), "ConfigError",
        "windows.sise (from --set). Did you mean windows.size?"),
    "setting without =": (with_arguments("--set", "windowssize"), "ConfigError", "NAME=VALUE"),
    "no velocity": (with_arguments("--set", "stage.velocity=v"), "GridNotFound", "stage.velocity"),
    "too little memory": (with_arguments("--set", "optimize.memory_limit_gib=0.01"), "PlanError",
        "0.0 GiB is available (optimize.memory_limit_gib)"),
    "too little for a grid": (with_arguments("--set", "grids.memory_limit_gib=0.1"),
        "GridTooLarge", "0 MiB are allowed"),
    "output is a file": (output_is_a_file, "LayerError", "notes.txt is a file"),
    "output in a file": (output_lies_in_a_file, "LayerError", "notes.txt, which is a file"),
    "frames' folder is a file": (frames_folder_is_a_file, "LayerError", "vdb is a file, and"),
    "layer is a folder": (layer_is_a_folder, "LayerError", "look.usda is a folder"),
    "no weights": (with_arguments("--set", "features.network=vgg19", "--set",
        "features.vgg19_file=/none.pth"), "FeatureError", "no VGG-19 weights at /none.pth"),
    "wrong layer": (with_arguments("--set", "features.layers=[nope]"), "ConfigError",
        "features.layers names 'nope'"),
    "wrong content layer": (with_arguments("--set", "features.content_layers=[relu1_1]"),
        "ConfigError", "features.content_layers names 'relu1_1'"),
    "weights of 0": (with_arguments("--set", "features.layers=[learned1]", "--set",
        "features.weights=[0]"), "ConfigError", "features.weights are all 0 for the style layers"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSALS)
def test_bad_input_is_refused_by_name_and_leaves_nothing_behind(
    shot: Shot, core: FakeCore, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    spoil, kind, message = REFUSALS[name]
    arguments = shot.arguments("--json", *spoil(shot))
    before = file_hashes(shot.folder)
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    error = json.loads(out)["error"]
    assert error["type"] == kind
    assert message in error["message"]
    assert err.endswith(f"usdsmoke: {error['message']}\n") and "Traceback" not in err
    assert file_hashes(shot.folder) == before
    assert not shot.output.exists()
    assert core.stylized == []


@pytest.mark.parametrize("is_above", [False, True])
def test_an_output_folder_that_may_not_be_read_is_named(
    shot: Shot, monkeypatch: pytest.MonkeyPatch, is_above: bool
) -> None:
    def access(*arguments: object) -> bool:
        if is_above:
            raise PermissionError
        return False

    shot.output.mkdir()
    monkeypatch.setattr("os.access", access)
    for call in (lambda: run(shot), lambda: assemble(shot.output)):
        with pytest.raises(LayerError, match=r"read.*permissions"):
            call()


SEEN_LATER = ("NaN", "cut off", "too little for a grid")


@pytest.mark.parametrize("name", [name for name in REFUSALS if name not in SEEN_LATER])
def test_a_dry_run_refuses_what_needs_no_voxel_to_be_seen(shot: Shot, name: str) -> None:
    spoil, _, _ = REFUSALS[name]
    assert main(shot.arguments("--dry-run", *spoil(shot))) == 1


@pytest.mark.usefixtures("core")
def test_repair_accepts_nan_and_puts_the_number_there(shot: Shot) -> None:
    write_nan(second_file(shot))
    assert main(shot.arguments("--repair", "nan=0.25")) == 0
    (written,) = shot.output.glob("vdb/*/smoke.0002.vdb")
    values = values_of(written)
    assert values[1, 2, 1] == values[3, 0, 0] == 0.125  # halved by the core
    assert np.isfinite(values).all() and values[0, 0, 0] == 0.5


@pytest.mark.usefixtures("core")
def test_other_grids_in_the_file_are_left_alone_whatever_they_hold(shot: Shot) -> None:
    nan = raw_grid(np.full((2, 2, 2), np.nan), name="heat")
    surface = raw_grid(np.ones((2, 2, 2)), name="surface", grid_class="level set")
    density = raw_grid(np.ones((4, 3, 2)), name="density")
    write_raw(second_file(shot), nan, surface, density)
    assert len(run(shot).frames) == 3


@pytest.mark.usefixtures("core")
def test_a_missing_class_and_missing_types_are_taken_as_fog(shot: Shot) -> None:
    write_vdb(second_file(shot), grid_class="")
    text = shot.stage.read_text()
    for line in ('token fieldClass = "fogVolume"', 'token fieldDataType = "float"'):
        text = text.replace(line, "")
    shot.stage.write_text(text)
    assert len(run(shot).frames) == 3


@pytest.mark.usefixtures("core")
def test_an_empty_frame_becomes_an_empty_frame(shot: Shot) -> None:
    write_raw(second_file(shot), raw_grid(np.zeros((0, 0, 0))))
    result = run(shot)
    assert values_of(result.frames[1]).size == 0
    assert values_of(result.frames[1], "emission").size == 0
    assert values_of(result.frames[2]).size > 0


@pytest.mark.usefixtures("core")
def test_two_styles_of_one_name_are_both_on_record(shot: Shot, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    Image.new("RGB", (8, 8), "blue").save(tmp_path / "other/style.png")
    assert main(shot.arguments("--style", str(tmp_path / "other/style.png"))) == 0
    (found,) = provenance(shot.output / "look.usda")
    assert len(set(found.record.styles)) == 2
    assert {style.name for style in found.record.styles} == {"style.png"}


@pytest.mark.usefixtures("core")
def test_sixteen_bits_that_overflow_in_the_last_frame_are_refused_before_the_first(
    tmp_path: Path, core: FakeCore
) -> None:
    shot = make_shot(tmp_path)
    write_vdb(tmp_path / "in/cache/smoke.0003.vdb", ("density",), value=70000.0)
    with pytest.raises(ConfigError, match="timeCode 3"):
        stylize(shot.stage, shot.style, shot.output, settings=["grids.half=true"])
    assert core.stylized == [] and core.coarse == []
    stylize(shot.stage, shot.style, shot.output)


@pytest.mark.usefixtures("core")
def test_sixteen_bits_are_checked_with_the_measured_extinction(tmp_path: Path) -> None:
    shot = make_shot(tmp_path)
    write_vdb(tmp_path / "in/cache/smoke.0003.vdb", ("density",), value=40000.0)
    with pytest.raises(ConfigError, match="emission at timeCode 3"):
        stylize(shot.stage, shot.style, shot.output, settings=["grids.half=true"])
    only = ["grids.half=true", "optimize.steps=[shape]"]
    stylize(shot.stage, shot.style, shot.folder / "shape", settings=only)
