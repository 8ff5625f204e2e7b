"""The wheel: built offline from a copy of the sources, and used from where it was unpacked."""

import os
import shutil
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

import usdsmoke

PROJECT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel's file."""
    folder = tmp_path_factory.mktemp("wheel")
    sources = folder / "sources"
    sources.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(PROJECT / name, sources)
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(PROJECT / "usdsmoke", sources / "usdsmoke", ignore=ignore)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-index"]
    command += ["--no-build-isolation", "--wheel-dir", str(folder), str(sources)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (built,) = folder.glob("*.whl")
    return built


def test_wheel_holds_every_source_file_and_the_plugin_and_nothing_else(wheel: Path) -> None:
    expected = {
        str(p.relative_to(PROJECT))
        for p in (PROJECT / "usdsmoke").rglob("*")
        if p.is_file() and "__pycache__" not in p.parts
    }
    assert "usdsmoke/plugin/plugInfo.json" in expected
    assert "usdsmoke/plugin/resources/usdSmoke/generatedSchema.usda" in expected
    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if ".dist-info/" not in name}
    assert packed == expected


def test_wheel_tells_version_licence_and_command(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        texts = {Path(name).name: archive.read(name).decode() for name in archive.namelist()}
    metadata = Parser().parsestr(texts["METADATA"])
    assert metadata["Version"] == usdsmoke.__version__
    assert metadata["License-Expression"] == "Apache-2.0"
    assert "Apache License" in texts["LICENSE"]
    assert "usdsmoke = usdsmoke.ui.cli.main:main" in texts["entry_points.txt"]


def test_unpacked_wheel_registers_its_schema(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    code = "from usdsmoke.usd import schema; print(schema.PLUGIN_FOLDER, schema.register_schema())"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert done.stdout.split() == [str(tmp_path / "usdsmoke" / "plugin"), "True"], done.stderr
