"""The command ``usdsmoke preview``: what it prints, its exit codes, what it loads."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fixtures.pipeline_fixtures import PROJECT, Shot
from usdsmoke.ui.cli.main import main


@pytest.mark.usefixtures("quick_grids")
def test_the_files_the_view_and_the_extinction_are_printed(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    target = shot.folder / "shot.png"
    assert main(["preview", str(shot.stage), "-o", str(target), "--width", "16"]) == 0
    out, err = capsys.readouterr()
    assert out.splitlines()[0] == str(target) and target.is_file() and err == ""
    assert "timeCodes 1-3, the front view, 16 x " in out
    assert "</World/smoke>: extinction " in out


@pytest.mark.usefixtures("quick_grids")
def test_json_is_one_value_with_what_was_drawn(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["-o", str(shot.folder / "a.exr"), "--size", "12x8", "--frames", "2-3", "--json"]
    assert main(["preview", str(shot.stage), *words]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [Path(name).name for name in result["files"]] == ["a.0002.exr", "a.0003.exr"]
    assert all(Path(name).is_file() for name in result["files"])
    assert (result["width"], result["height"], result["time_codes"]) == (12, 8, [2, 3])
    assert result["extinction_per_density"]["/World/smoke"] > 0


def test_a_named_error_is_one_sentence_and_exit_code_1(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    target = shot.folder / "a.png"
    words = ["preview", str(shot.stage), "-o", str(target), "--camera", "/none"]
    assert main(words) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "</none>" in err and "no camera" in err
    assert not target.exists()


@pytest.mark.parametrize("words", [["--size", "12"], ["--size", "axb"], ["--background", "red"]])
def test_wrong_usage_ends_with_2(words: list[str], shot: Shot) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["preview", str(shot.stage), "-o", str(shot.folder / "a.png"), *words])
    assert stopped.value.code == 2


def test_a_picture_is_drawn_without_torch(shot: Shot) -> None:
    """Loading it takes longer than all the rest; here an extinction is measured too."""
    target = shot.folder / "a.png"
    code = (
        "import sys\nfrom usdsmoke.ui.cli.main import main\n"
        f"code = main(['preview', {str(shot.stage)!r}, '-o', {str(target)!r}, '--width', '16'])\n"
        "sys.exit(code or 3 * ('torch' in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=PROJECT, timeout=60)
    assert done.returncode == 0 and target.is_file()
