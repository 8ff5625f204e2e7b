"""A missing package is one line with the fix, before anything else happens."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fixtures.import_graph import PROJECT
from tests.fixtures.pipeline_fixtures import Shot, make_shot
from usdsmoke.base.errors import MissingPackage
from usdsmoke.base.machine import check_packages

_HIDE = """
import importlib.abc, sys
class Hidden(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {hidden!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hidden())
from importlib import util
real = util.find_spec
util.find_spec = lambda name, package=None: None if name in {hidden!r} else real(name, package)
from usdsmoke.ui.cli.main import main
sys.exit(main({words!r}))
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Shot:
    return make_shot(tmp_path_factory.mktemp("packages"))


def run_without(hidden: tuple[str, ...], words: list[str]) -> tuple[int, str]:
    """Exit code and stderr of a command in a process that cannot find some packages."""
    done = subprocess.run(
        [sys.executable, "-c", _HIDE.format(hidden=hidden, words=words)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        check=False,
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    ("hidden", "fix"),
    [
        (("torch",), "pip install torch"),
        (("PIL",), "pip install pillow"),
        (("openvdb", "pyopenvdb"), "openvdb"),
        (("pxr",), "pip install usd-core"),
        (("pydantic",), "pip install pydantic"),
        (("rich",), "pip install rich"),
    ],
)
def test_one_line_names_the_package_and_the_fix(
    hidden: tuple[str, ...], fix: str, made: Shot, tmp_path: Path
) -> None:
    words = ["stylize", str(made.stage), "--style", str(made.style), "-o", str(tmp_path / "out")]
    code, text = run_without(hidden, words)
    assert code == 1 and fix in text
    assert len(text.strip().splitlines()) == 1 and "Traceback" not in text
    assert not (tmp_path / "out").exists()


def test_only_what_writes_exr_files_needs_openexr(made: Shot, tmp_path: Path) -> None:
    preview = ["preview", str(made.stage), "--frames", "1", "-o"]
    code, text = run_without(("OpenEXR",), [*preview, str(tmp_path / "a.exr")])
    assert code == 1 and "pip install OpenEXR" in text and len(text.splitlines()) == 1
    assert run_without(("OpenEXR",), [*preview, str(tmp_path / "a.png")])[0] == 0


def test_packages_that_are_there_pass() -> None:
    check_packages("json", "numpy")
    with pytest.raises(MissingPackage, match="no_such_package"):
        check_packages("no_such_package")
