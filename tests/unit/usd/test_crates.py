"""Crate files are read by a process with limits before OpenUSD reads them in this one."""

from pathlib import Path

import pytest
from pxr import Sdf, Usd, UsdGeom, Vt

from usdsmoke.base.errors import StageError
from usdsmoke.usd import crates
from usdsmoke.usd.diagnostics import open_quietly
from usdsmoke.vdb import child


def write_crate(file_path: Path, reference: str = "") -> Path:
    """A stage with some arrays, as a crate file."""
    stage = Usd.Stage.CreateInMemory()
    prim = UsdGeom.Points.Define(stage, "/World/points")
    prim.CreatePointsAttr(Vt.Vec3fArray([(n, n * n, 1) for n in range(200)]))
    stage.SetDefaultPrim(stage.GetPrimAtPath("/World"))
    if reference:
        stage.DefinePrim("/World/more").GetReferences().AddReference(reference)
    stage.GetRootLayer().Export(str(file_path), args={"format": "usdc"})
    return file_path


def damage(file_path: Path) -> None:
    """Of an array: its place in the file lies beyond the end."""
    data = bytearray(file_path.read_bytes())
    del data[-12:]
    file_path.write_bytes(data)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the files that the worker was asked about."""
    names: list[str] = []
    run_child = child.run_child

    def watched(request, arrays, config):  # type: ignore[no-untyped-def]
        names.append(Path(request["file_path"]).name)
        return run_child(request, arrays, config)

    monkeypatch.setattr(child, "run_child", watched)
    return names


def test_a_sound_crate_is_looked_at_once_and_opened(tmp_path: Path, asked: list[str]) -> None:
    write_crate(tmp_path / "b.usdc")
    root = write_crate(tmp_path / "a.usd", "./b.usdc")
    stage = open_quietly(str(root))
    assert sorted(asked) == ["a.usd", "b.usdc"]
    assert len(stage.GetPrimAtPath("/World/more/points").GetAttribute("points").Get()) == 200


def test_a_damaged_crate_is_refused_before_this_process_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: object) -> None:
        raise AssertionError("this process has read a damaged crate file")

    root = write_crate(tmp_path / "a.usdc")
    damage(root)
    monkeypatch.setattr(Usd.Stage, "Open", refuse)
    monkeypatch.setattr(Sdf.Layer, "FindOrOpen", refuse)
    with pytest.raises(StageError, match=r"a\.usdc"):
        open_quietly(str(root))


def test_the_damaged_one_of_many_is_named(tmp_path: Path) -> None:
    damage(write_crate(tmp_path / "deep.usdc"))
    write_crate(tmp_path / "middle.usdc", "./deep.usdc")
    root = tmp_path / "root.usda"
    root.write_text("#usda 1.0\n(\n    subLayers = [@./middle.usdc@]\n)\n")
    with pytest.raises(StageError, match=r"deep\.usdc"):
        open_quietly(str(root))


def test_text_layers_and_large_crates_start_no_process(
    tmp_path: Path, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.usda").write_text('#usda 1.0\ndef "World"\n{\n}\n')
    open_quietly(str(tmp_path / "a.usda"))
    monkeypatch.setattr(crates, "LARGE", 16)
    open_quietly(str(write_crate(tmp_path / "b.usdc")))
    assert asked == []


def test_layers_that_refer_to_each_other_in_a_circle_end(tmp_path: Path, asked: list[str]) -> None:
    write_crate(tmp_path / "a.usdc", "./b.usdc")
    write_crate(tmp_path / "b.usdc", "./a.usdc")
    assert crates.check_crates(str(tmp_path / "a.usdc")) == []
    assert sorted(asked) == ["a.usdc", "b.usdc"]
