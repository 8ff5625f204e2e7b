"""The command: exit codes, stdout and stderr, JSON, help, signals, what it loads."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.fixtures.pipeline_fixtures import Shot
from tests.fixtures.usd_fixtures import file_hashes, needs_usd, write_text
from usdsmoke import __version__
from usdsmoke.config.resolve import read_settings, resolve_config
from usdsmoke.config.settings import Config
from usdsmoke.ui.cli.main import main

PROJECT = Path(__file__).resolve().parents[2]


def run_command(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "usdsmoke", *arguments],
        capture_output=True,
        text=True,
        cwd=PROJECT,
        timeout=60,
        **options,
    )


def loaded_by(*commands: list[str]) -> set[str]:
    """Top-level packages that commands load, in a fresh interpreter."""
    code = (
        "import sys\nfrom usdsmoke.ui.cli.main import main\n"
        f"codes = [main(command) for command in {list(commands)!r}]\n"
        "print('LOADED', *sorted({name.split('.')[0] for name in sys.modules}))\n"
        "sys.exit(any(codes))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=PROJECT, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.rpartition("LOADED")[2].split())


# The whole way


@pytest.mark.usefixtures("core")
def test_stylize_prints_where_the_result_is_and_says_the_rest_on_stderr(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shot.arguments()) == 0
    out, err = capsys.readouterr()
    assert re.search(rf"^open +{shot.output / 'shot_look.usda'}$", out, re.MULTILINE)
    assert re.search(r"steadiness over time +50\.00% ", out)
    assert "usdsmoke validate" in out
    assert "plan for" in err and "estimate" in err
    assert "check frame 1/3" in err and "plan for" not in out


@pytest.mark.usefixtures("core")
def test_json_is_one_value_with_the_result_and_its_plan(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shot.arguments("--json")) == 0
    result = json.loads(capsys.readouterr().out)
    assert Path(result["root_stage"]).is_file()
    assert all(Path(name).is_file() for name in result["frames"] + result["contact_sheets"])
    assert len(result["plan"]["frames"]) == 3


@pytest.mark.usefixtures("core")
def test_options_and_settings_override_the_file_in_this_order(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "optimize: {seed: 1, threads: 1}\nwindows: {size: 5}\ngrids: {half: false}\n"
    config = str(write_text(shot.folder / "look.yaml", text))
    options = ["--config", config, "--seed", "2", "--half", "--set", "optimize.seed=3"]
    options += ["--repair", "nan=0.5", "--frames", "2-3", "--prim", "/World/smoke"]
    assert main(shot.arguments("--dry-run", "--json", *options)) == 0
    resolved = json.loads(capsys.readouterr().out)["config"]
    assert resolved["optimize"]["seed"] == 3
    assert resolved["optimize"]["threads"] == 1
    assert resolved["windows"]["size"] == 5
    assert resolved["grids"]["half"] is True
    assert resolved["grids"]["repair_nan"] == 0.5
    assert resolved["stage"]["frames"] == "2-3"
    assert resolved["stage"]["prims"] == ["/World/smoke"]


def test_a_repair_beyond_single_precision_is_refused(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shot.arguments("--dry-run", "--repair", "nan=1e39")) == 1
    assert "1e+39" in capsys.readouterr().err


def test_a_dry_run_prints_the_plan_and_writes_nothing(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    before = file_hashes(shot.folder)
    assert main(shot.arguments("--dry-run")) == 0
    out, err = capsys.readouterr()
    assert out.startswith("plan for") and "left out" in out and err == ""
    assert file_hashes(shot.folder) == before


@pytest.mark.usefixtures("core")
def test_a_dry_run_notes_that_the_run_itself_would_be_refused(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shot.arguments()) == 0
    capsys.readouterr()
    other = ["--set", "optimize.seed=7"]
    for options, refused in (
        (other, "different settings"),
        ([], "already holds this result"),
        ([*other, "--force"], ""),
        (["--window", "0"], ""),
    ):
        assert main(shot.arguments("--dry-run", *options)) == bool(refused)
        out = capsys.readouterr().out
        assert ("the run would be refused" in out) == bool(refused) and refused in out
    assert main(shot.arguments(*other)) == 1


@pytest.mark.parametrize("window", ["7", "-1"])
def test_a_dry_run_refuses_a_window_that_there_is_not(
    shot: Shot, capsys: pytest.CaptureFixture[str], window: str
) -> None:
    assert main(shot.arguments("--dry-run", "--window", window)) == 1
    assert f"there is no window {window}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["stylise", "shot.usda"], "stylize"),
        (["stylize", "shot.usda", "-o", "look", "--stile", "a.png"], "--style"),
        (["validate", "shot.usda", "--junot", "a.xml"], "--junit"),
    ],
)
def test_an_unknown_command_or_option_names_the_nearest(
    arguments: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert f"Did you mean {meant}?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "facts"),
    [
        (["compare", "a", "b"], ("no command 'compare'", "inspect, stage, stylize")),
        (["stylize", "a.usda", "--preset", "dailly"], ("--preset", "'dailly'", "daily?")),
    ],
)
def test_a_word_that_is_no_choice_is_told_with_the_choices(
    arguments: list[str], facts: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(arguments)
    said = capsys.readouterr().err
    assert all(fact in said for fact in facts) and "invalid" not in said


@pytest.mark.parametrize(
    ("arguments", "fact"),
    [
        (["stylize", "--json", "a.usda"], "-o OUT"),
        (["inspect", "a.usda", "--json", "--fields"], "--fields"),
        (["compare", "--json"], "compare"),
        (["stylize", "a.usda", "--json", "-o", ""], "--output"),
    ],
)
def test_wrong_usage_is_a_json_value_too(
    arguments: list[str], fact: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    told = json.loads(capsys.readouterr().out)["error"]
    assert ended.value.code == 2 and told["type"] == "WrongUsage" and fact in told["message"]


def test_the_plan_lists_its_windows_by_number_where_there_are_several(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shot.arguments("--dry-run", "--set", "windows.size=2", "--verbose")) == 0
    assert (
        "windows\n  window 0: </World/smoke> timeCodes 1,2, and 3 shared with window 1\n"
        "  window 1: </World/smoke> timeCode 3\n"
    ) in capsys.readouterr().out
    assert main(shot.arguments("--dry-run", "--verbose")) == 0
    assert "windows\n" not in capsys.readouterr().out


def test_a_dry_run_reads_no_voxel(shot: Shot, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: object) -> None:
        raise AssertionError("a VDB file was opened by OpenVDB")

    monkeypatch.setattr("usdsmoke.vdb.child.run_child", refuse)
    assert main(shot.arguments("--dry-run", "--json")) == 0


@needs_usd(26, 5)
def test_inspect_validate_and_dry_runs_load_no_torch(shot: Shot) -> None:
    (shot.stage.parent / "shot.usda").write_text(
        shot.stage.read_text().replace(
            "rel field", "float3[] extent = [(0, 0, 0), (2, 2, 1)]\n rel field"
        )
    )
    stage = str(shot.stage)
    loaded = loaded_by(["inspect", stage], ["validate", stage], shot.arguments("--dry-run"))
    assert "pxr" in loaded
    assert "torch" not in loaded


def test_inspect_shows_volumes_frames_grids_and_sizes(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(shot.stage), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (volume,) = found["volumes"]
    assert volume["prim_path"] == "/World/smoke" and volume["time_codes"] == [1, 2, 3]
    field = volume["frames"][1]["fields"]["density"]
    assert field["file"].endswith("cache/smoke.0002.vdb")
    (grid,) = field["grids"]
    assert (grid["name"], grid["type"], grid["class"]) == ("density", "float", "fog volume")
    assert grid["active_voxels"] == 24 and grid["box"] == [4, 3, 2]
    assert grid["index_to_world"][0] == [0.5, 0, 0, 0]
    assert field["field_to_stage"][3] == [0, 0, 0, 1]
    assert found["stage"]["up_axis"] == "Z" and found["stage"]["meters_per_unit"] == 0.5

    assert main(["inspect", str(shot.stage), "--frames", "2"]) == 0
    text = capsys.readouterr().out
    assert "Volume </World/smoke>: 1 frame" in text
    row = ["2", "density", "density", "float", "fog", "volume", "24", "4", "x", "3", "x", "2"]
    assert [*row, "smoke.0002.vdb"] in [line.split() for line in text.splitlines()]


def test_inspect_reports_problems_in_place_and_exits_with_1(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    (shot.stage.parent / "cache/smoke.0002.vdb").write_bytes(b"not a VDB file")
    assert main(["inspect", str(shot.stage), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    problems = [f["fields"]["density"].get("problem", "") for f in found["volumes"][0]["frames"]]
    assert problems[0] == problems[2] == "" and "smoke.0002.vdb" in problems[1]
    assert main(["inspect", str(shot.stage)]) == 1
    problem = f"problem: field </World/smoke/density>, timeCode 2: {problems[1]}"
    assert problem in capsys.readouterr().out


@needs_usd(26, 5)
@pytest.mark.usefixtures("core")
def test_validate_tells_a_sound_result_from_a_damaged_one(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    main(shot.arguments())
    root = str(shot.output / "shot_look.usda")
    capsys.readouterr()
    assert main(["validate", root, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["errors"] == 0
    (frame,) = shot.output.glob("vdb/*/smoke.0002.vdb")
    frame.unlink()
    assert main(["validate", root]) == 1
    out = capsys.readouterr().out
    assert "error" in out and "smoke.0002.vdb" in out


def test_settings_prints_a_file_that_can_be_given_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["settings"]) == 0
    config = write_text(tmp_path / "all.yaml", capsys.readouterr().out)
    assert resolve_config(read_settings(config)) == Config()
    assert main(["settings", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == Config().model_dump()


@needs_usd(26, 5)
@pytest.mark.usefixtures("core")
def test_relative_paths_mean_the_folder_one_is_in(
    shot: Shot, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(shot.folder)
    command = ["stylize", "in/shot.usda", "--style", "in/style.png", "-o", "looks/fire", "--json"]
    assert main(command) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["root_stage"] == str(shot.folder / "looks/fire/shot_look.usda")
    assert main(["validate", "looks/fire/shot_look.usda"]) == 0


# Usage


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["paint"],
        ["stylize", "shot.usda"],
        ["stylize", "shot.usda", "--style", "x.png"],
        ["stylize", "shot.usda", "--style", "x.png", "-o", "out", "--repair", "nan"],
        ["stylize", "shot.usda", "--style", "x.png", "-o", "out", "--repair", "nan=inf"],
        ["stylize", "shot.usda", "--style", "x.png", "-o", "out", "--seed", "one"],
        ["stylize", "shot.usda", "--style", "x.png", "-o", "out", "--window", "one"],
        ["stylize", "shot.usda", "--style", "x.png", "-o", "out", "--window", "1", "--coarse"],
        ["assemble"],
        ["inspect"],
        ["inspect", "a.usda", "b.usda"],
        ["inspect", ""],
        ["stylize", "shot.usda", "--style", "x.png", "--style", "", "-o", "out"],
        ["stylize", "shot.usda", "--style", "x.png", "-o", ""],
        ["verify", ""],
    ],
)
def test_wrong_usage_exits_with_2_and_says_how_it_is_meant(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    out, err = capsys.readouterr()
    *usage, line = err.splitlines()
    assert out == "" and line.startswith("usdsmoke")
    assert bool(usage) == ("required" in line)


def test_the_help_lists_every_section_and_every_setting(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["stylize", "--help"])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    for section, settings in Config().model_dump().items():
        assert f"{section}: {', '.join(settings)}" in " ".join(text.split())


def test_python_m_usdsmoke_is_the_command() -> None:
    done = run_command("--version")
    assert (done.returncode, done.stdout.strip()) == (0, f"usdsmoke {__version__}")
    failed = run_command("inspect", "nowhere.usda", "--json")
    assert failed.returncode == 1
    error = json.loads(failed.stdout)["error"]
    assert error["type"] == "StageError" and "nowhere.usda" in error["message"]
    assert failed.stderr == f"usdsmoke: {error['message']}\n"
