"""A published file is the old one or the whole new one, whatever happens in between."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from usdsmoke.base import publish
from usdsmoke.base.errors import DamagedFile, WriteFailed
from usdsmoke.base.publish import publish_file, publish_new, remove_leftovers

PROJECT = Path(__file__).resolve().parents[3]


def test_new_file_takes_the_old_ones_place(tmp_path: Path) -> None:
    target = tmp_path / "smoke.0001.vdb"
    target.write_text("old")
    publish_file(target, lambda temporary: temporary.write_text("new"))
    assert target.read_text() == "new"
    assert os.listdir(tmp_path) == ["smoke.0001.vdb"]


def test_writer_gets_a_hidden_name_with_the_same_suffix_in_the_same_folder(tmp_path: Path) -> None:
    seen = []

    def write(temporary: Path) -> None:
        seen.append(temporary)
        temporary.write_text("new")

    publish_file(tmp_path / "smoke.0001.vdb", write)
    assert seen[0].parent == tmp_path
    assert seen[0].name.startswith(".smoke.0001.tmp-")
    assert seen[0].suffix == ".vdb"


def test_file_is_not_in_place_while_it_is_checked(tmp_path: Path) -> None:
    target = tmp_path / "look.usda"

    def check(temporary: Path) -> None:
        assert temporary.read_text() == "new"
        assert not target.exists()

    publish_file(target, lambda temporary: temporary.write_text("new"), check)
    assert target.read_text() == "new"


@pytest.mark.parametrize("fault", [DamagedFile("bad"), ZeroDivisionError(), KeyboardInterrupt()])
@pytest.mark.parametrize("stage", ["write", "check"])
def test_a_fault_keeps_the_old_file_and_leaves_nothing(
    tmp_path: Path, fault: BaseException, stage: str
) -> None:
    target = tmp_path / "smoke.vdb"
    target.write_text("old")

    def step(name: str, temporary: Path) -> None:
        if name == "write":
            temporary.write_text("half")
        if name == stage:
            raise fault

    with pytest.raises(type(fault)):
        publish_file(target, lambda path: step("write", path), lambda path: step("check", path))
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["smoke.vdb"]


@pytest.mark.parametrize(
    ("number", "advice"),
    [(errno.ENOSPC, "some space"), (errno.EROFS, "mounted for writing"), (errno.EIO, "its disk")],
)
def test_operating_system_errors_say_what_where_and_what_to_do(
    tmp_path: Path, number: int, advice: str
) -> None:
    def write(temporary: Path) -> None:
        temporary.write_text("half")
        raise OSError(number, os.strerror(number))

    with pytest.raises(WriteFailed, match=advice) as caught:
        publish_file(tmp_path / "smoke.0007.vdb", write)
    for part in ("smoke.0007.vdb", str(tmp_path), os.strerror(number)):
        assert part in str(caught.value)
    assert os.listdir(tmp_path) == []


def test_full_disk_is_named(tmp_path: Path) -> None:
    """A file size limit stands in for the full disk: both end a write half-way."""
    code = (
        "import resource, sys\n"
        "from pathlib import Path\n"
        "from usdsmoke.base.errors import WriteFailed\n"
        "from usdsmoke.base.publish import publish_file\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try:\n"
        "    publish_file(Path(sys.argv[1]), lambda path: path.write_bytes(bytes(5000)))\n"
        "except WriteFailed as error:\n"
        "    print(error)\n"
    )
    target = tmp_path / "smoke.vdb"
    target.write_text("old")
    said = run_python(code, target)
    assert "cannot write smoke.vdb" in said
    assert "File too large" in said
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["smoke.vdb"]


def test_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(WriteFailed, match=r"a\.vdb.*No such file.*folder first"):
        publish_file(tmp_path / "none" / "a.vdb", lambda temporary: temporary.write_text("x"))


def test_writer_that_writes_nothing_is_found_out(tmp_path: Path) -> None:
    with pytest.raises(WriteFailed, match=r"a\.vdb"):
        publish_file(tmp_path / "a.vdb", lambda temporary: None)


def test_folder_of_the_targets_name_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.vdb").mkdir()
    with pytest.raises(WriteFailed, match=r"a\.vdb.*folder"):
        publish_file(tmp_path / "a.vdb", lambda temporary: temporary.write_text("x"))
    assert os.listdir(tmp_path) == ["a.vdb"]


def test_read_only_folder_is_named(tmp_path: Path) -> None:
    if os.geteuid() == 0:
        pytest.skip("root may write into read-only folders")
    tmp_path.chmod(0o555)
    with pytest.raises(WriteFailed, match="be written"):
        publish_file(tmp_path / "a.vdb", lambda temporary: temporary.write_text("x"))


def test_file_and_folder_are_synced_before_and_after_the_rename(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = []
    sync, replace = publish._sync, os.replace
    monkeypatch.setattr(publish, "_sync", lambda path: steps.append(path.name) or sync(path))
    monkeypatch.setattr(os, "replace", lambda a, b: steps.append("rename") or replace(a, b))
    publish_file(tmp_path / "a.vdb", lambda temporary: temporary.write_text("x"))
    assert steps[0].startswith(".a.tmp-")
    assert steps[1:] == ["rename", tmp_path.name]


def test_kill_during_the_write_keeps_the_old_file_and_one_that_is_alone_clears_up(
    tmp_path: Path,
) -> None:
    code = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from usdsmoke.base.publish import publish_file\n"
        "def write(path):\n"
        "    path.write_text('half')\n"
        "    print('written', flush=True)\n"
        "    time.sleep(60)\n"
        "publish_file(Path(sys.argv[1]), write)\n"
    )
    target = tmp_path / "smoke.vdb"
    target.write_text("old")
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(target)], cwd=PROJECT, stdout=subprocess.PIPE, text=True
    )
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "written\n"
        process.send_signal(signal.SIGKILL)
    assert target.read_text() == "old"
    assert len(os.listdir(tmp_path)) == 2
    remove_leftovers(tmp_path)  # somebody else may be writing it
    assert len(os.listdir(tmp_path)) == 2
    remove_leftovers(tmp_path, alone=True)
    assert os.listdir(tmp_path) == ["smoke.vdb"]


def test_only_temporaries_are_removed(tmp_path: Path) -> None:
    names = {".a.vdb", "a.tmp-00000000.vdb", ".a.tmp-xyz.vdb", "..tmp-00000000.vdb"}
    for name in (*names, ".a.tmp-00000000.vdb"):
        (tmp_path / name).write_text("x")
    remove_leftovers(tmp_path, alone=True)
    assert set(os.listdir(tmp_path)) == names
    remove_leftovers(tmp_path / "none", alone=True)


def test_temporaries_of_named_files_and_those_of_yesterday_are_abandoned(tmp_path: Path) -> None:
    for name in ("look", "old", "new"):
        (tmp_path / f".{name}.tmp-0123abcd.usda").write_text("x")
    days_ago = time.time() - 2 * 24 * 3600
    os.utime(tmp_path / ".old.tmp-0123abcd.usda", (days_ago, days_ago))
    remove_leftovers(tmp_path, of=["look.usda"])
    assert os.listdir(tmp_path) == [".new.tmp-0123abcd.usda"]


def run_python(code: str, *arguments: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


def test_of_several_new_files_the_first_one_stays(tmp_path: Path) -> None:
    target = tmp_path / "run.json"
    assert publish_new(target, lambda path: path.write_text("first"))
    assert not publish_new(target, lambda path: path.write_text("second"))
    assert target.read_text() == "first"
    assert list(tmp_path.iterdir()) == [target]


def test_without_hard_links_a_new_file_is_put_in_place_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*names: object) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    assert publish_new(tmp_path / "run.json", lambda path: path.write_text("first"))
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]
