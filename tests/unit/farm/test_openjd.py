"""The job template: accepted by the specification's own model, equal for equal runs, no machine."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.fixtures.pipeline_fixtures import Shot
from tests.fixtures.usd_fixtures import file_hashes
from usdsmoke.base.errors import ConfigError, OutputExists, PlanError
from usdsmoke.config.resolve import read_settings, resolve_config
from usdsmoke.farm.openjd import JobBundle, bundle_text, job_parameters, job_template, submit
from usdsmoke.pipeline import Request
from usdsmoke.ui.cli.main import main


def make(shot: Shot, *settings: str, **options: Any) -> JobBundle:
    return submit(Request(shot.stage, shot.style, shot.output, settings), **options)


def read(file_path: Path) -> Any:
    return yaml.safe_load(file_path.read_text(encoding="utf-8"))


def decoded(template: dict[str, Any]) -> Any:
    model = pytest.importorskip("openjd.model", reason="openjd-model is not installed")
    return model.decode_job_template(template=yaml.safe_load(bundle_text(template)))


def created(template: dict[str, Any], folder: Path, **values: str) -> Any:
    """The job that a queue makes of the template."""
    model = pytest.importorskip("openjd.model", reason="openjd-model is not installed")
    job = decoded(template)
    parameters = model.preprocess_job_parameters(
        job_template=job,
        job_parameter_values=values,
        job_template_dir=folder,
        current_working_dir=folder,
    )
    return model.create_job(job_template=job, job_parameter_values=parameters)


VALUES = {
    "Stage": "/a.usd",
    "Style1": "/s.png",
    "Output": "/out",
    "Settings": "/c.yaml",
    "Overrides": "/o.yaml",
}


@pytest.mark.parametrize("n_windows", [1, 2, 3000])
def test_the_model_makes_one_task_of_each_window(tmp_path: Path, n_windows: int) -> None:
    model = pytest.importorskip("openjd.model", reason="openjd-model is not installed")
    values = dict(VALUES)
    job = created(job_template("shot", n_windows, 1, 2.5), tmp_path, **values)
    steps = {step.name: step for step in job.steps}
    assert list(steps) == ["Coarse", "Windows", "Assemble"]
    space = model.StepParameterSpaceIterator(space=steps["Windows"].parameterSpace)
    assert [int(task["Window"].value) for task in space] == list(range(n_windows))
    assert steps["Coarse"].parameterSpace is None and steps["Assemble"].parameterSpace is None


def test_windows_wait_for_the_coarse_step_and_the_assembly_for_both(tmp_path: Path) -> None:
    model = pytest.importorskip("openjd.model", reason="openjd-model is not installed")
    values = dict(VALUES)
    graph = model.StepDependencyGraph(job=created(job_template("s", 2, 1, 1.0), tmp_path, **values))
    order = [step.name for step in graph.topo_sorted()]
    assert order == ["Coarse", "Windows", "Assemble"]
    edges = {edge.origin.step.name for edge in graph.step_node(stepname="Assemble").in_edges}
    assert edges == {"Coarse", "Windows"}


def test_every_style_is_a_parameter_and_an_argument() -> None:
    template = job_template("shot", 1, 3, 1.0)
    decoded(template)
    arguments = template["steps"][0]["script"]["actions"]["onRun"]["args"]
    assert arguments[2:8] == [
        *("--style", "{{Param.Style1}}"),
        *("--style", "{{Param.Style2}}"),
        *("--style", "{{Param.Style3}}"),
    ]


def test_files_that_tasks_read_and_write_are_marked_for_job_attachments() -> None:
    definitions = job_template("shot", 1, 1, 1.0)["parameterDefinitions"]
    flow = {d["name"]: (d["objectType"], d["dataFlow"]) for d in definitions if "dataFlow" in d}
    assert flow == {
        "Stage": ("FILE", "IN"),
        "Style1": ("FILE", "IN"),
        "Output": ("DIRECTORY", "INOUT"),
        "Settings": ("FILE", "IN"),
        "Overrides": ("FILE", "IN"),
    }


def test_a_task_asks_for_the_memory_that_the_plan_estimates() -> None:
    steps = job_template("shot", 1, 1, 2.0001)["steps"]
    amounts = [{"name": "amount.worker.memory", "min": 2049}]
    assert [step["hostRequirements"]["amounts"] for step in steps] == [amounts] * 3


@pytest.mark.parametrize("name", ["{{Param.Stage}}", "a\x07b\n", "x" * 300, "烟 fumée", ""])
def test_whatever_the_stage_is_called_the_job_gets_a_name_that_the_model_takes(name: str) -> None:
    assert decoded(job_template(name, 1, 1, 1.0)).name.startswith("usdsmoke")


@pytest.mark.parametrize("command", ["", "  ", "{{Param.Stage}}", "usd\nsmoke"])
def test_a_command_that_no_queue_can_run_is_refused(command: str) -> None:
    with pytest.raises(ConfigError, match="a queue"):
        job_template("shot", 1, 1, 1.0, command)


@pytest.mark.usefixtures("core")
def test_a_line_of_a_shell_is_refused_and_a_program_with_a_space_in_its_path_is_not(
    shot: Shot,
) -> None:
    with pytest.raises(ConfigError, match=r'one program(.|\n)*exec python -m usdsmoke "\$@"'):
        submit(Request(shot.stage, shot.style, shot.output), command="python -m usdsmoke")
    assert not shot.output.exists()
    program = shot.folder / "my tools"
    program.touch()
    submit(Request(shot.stage, shot.style, shot.output), command=str(program))


def test_more_styles_than_a_template_can_name_are_refused() -> None:
    decoded(job_template("shot", 1, 45, 1.0))
    with pytest.raises(PlanError, match=r"46.*51 job parameters"):
        job_template("shot", 1, 46, 1.0)


def test_a_path_too_long_for_a_parameter_is_refused() -> None:
    with pytest.raises(PlanError, match="has 1025 "):
        job_parameters("/" + "s" * 1024, [], "/out", "/settings.yaml", "/overrides.yaml")


@pytest.mark.usefixtures("core")
def test_the_bundle_passes_the_check_of_the_openjd_command(shot: Shot) -> None:
    bundle = make(shot, "windows.size=1")
    openjd = Path(sys.executable).with_name("openjd")
    if not openjd.exists():
        pytest.skip("openjd-cli is not installed beside this Python")
    done = subprocess.run([openjd, "check", bundle.template], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert bundle.n_windows == 3


def test_equal_runs_give_equal_files_and_the_template_names_no_folder(shot: Shot) -> None:
    bundle = make(shot)
    before = file_hashes(bundle.template.parent)
    assert file_hashes(make(shot).template.parent) == before
    assert str(shot.folder) not in bundle.template.read_text(encoding="utf-8")
    assert {path.name for path in bundle.template.parent.iterdir()} == {
        "template.yaml",
        "settings.yaml",
        "overrides.yaml",
        "parameter_values.yaml",
        "asset_references.yaml",
    }


def test_the_bundle_holds_all_settings_and_lists_every_file_that_is_read(shot: Shot) -> None:
    config = {"windows": {"size": 2}}
    bundle = submit(
        Request(shot.stage, shot.style, shot.output, [resolve_config(config), "optimize.seed=5"])
    )
    settings, overrides, values, references = bundle.files
    assert read(overrides) == {"optimize": {"seed": 5}}
    expected = resolve_config(config, ["optimize.seed=5"])
    assert resolve_config(read_settings(settings)) == expected
    pairs = {pair["name"]: pair["value"] for pair in read(values)["parameterValues"]}
    assert pairs == bundle.parameters
    assert pairs["Stage"] == str(shot.stage) and pairs["Output"] == str(shot.output)
    inputs = read(references)["assetReferences"]["inputs"]["filenames"]
    vdbs = [str(path) for path in (shot.folder / "in/cache").iterdir()]
    assert set(inputs) == {str(shot.stage), str(shot.style), *vdbs}


def test_the_command_tells_how_to_run_the_job(
    shot: Shot, capsys: pytest.CaptureFixture[str]
) -> None:
    template = shot.folder / "job/template.yaml"
    options = ["--template", str(template), "--set", "windows.size=1", "--command", "/opt/smoke"]
    assert main(["submit", *shot.arguments(*options)[1:]]) == 0
    out, err = capsys.readouterr()
    assert "plan for" in err and "estimate" in err
    assert "3 windows" in out and f"deadline bundle submit {template.parent}" in out
    assert f"openjd run {template} -p Stage={shot.stage} " in out
    commands = [d for d in read(template)["parameterDefinitions"] if d["name"] == "Command"]
    assert [command["default"] for command in commands] == ["/opt/smoke"]
    assert not shot.output.exists()


def test_a_plan_that_this_machine_could_not_run_is_written_all_the_same(shot: Shot) -> None:
    assert make(shot, "optimize.memory_limit_gib=0.001").template.is_file()


def test_a_file_of_somebody_else_is_not_replaced(shot: Shot) -> None:
    own = shot.folder / "settings.yaml"
    own.write_text("optimize: {seed: 3}\n", encoding="utf-8")
    with pytest.raises(OutputExists, match=r"settings\.yaml .*--template"):
        submit(Request(shot.stage, shot.style, shot.output, own), template=shot.folder / "job.yaml")
    assert own.read_text(encoding="utf-8") == "optimize: {seed: 3}\n"
    assert not (shot.folder / "job.yaml").exists()
