"""Locks: one alone or several together, waiting, letting go, leaving nothing behind."""

import errno
import fcntl
import threading
import time
from pathlib import Path

import pytest

from usdsmoke.base import locks
from usdsmoke.base.errors import OutputExists
from usdsmoke.base.locks import hold_file, lock_output


def test_one_that_is_alone_keeps_everybody_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(locks, "_PATIENCE", 0.1)
    with lock_output(tmp_path):
        for alone in (True, False):
            with pytest.raises(OutputExists, match="another usdsmoke"):
                with lock_output(tmp_path, alone):
                    pass
    with lock_output(tmp_path):
        pass


@pytest.mark.parametrize("alone", [True, False])
def test_one_that_waits_comes_in_when_the_other_has_left(tmp_path: Path, alone: bool) -> None:
    first = lock_output(tmp_path)
    first.__enter__()
    with lock_output(tmp_path, alone, waits=lambda: first.__exit__(None, None, None)):
        with pytest.raises(OutputExists):
            with lock_output(tmp_path):
                pass


def test_one_that_waits_gives_up_after_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(locks, "_PATIENCE", 0.0)
    monkeypatch.setattr(locks, "_LONG_PATIENCE", 0.2)
    waited: list[bool] = []
    with lock_output(tmp_path), pytest.raises(OutputExists, match="another usdsmoke"):
        with lock_output(tmp_path, waits=lambda: waited.append(True)):
            pass
    assert waited == [True]


def test_several_may_share_and_keep_out_one_that_wants_to_be_alone(tmp_path: Path) -> None:
    with lock_output(tmp_path, alone=False) as first:
        with lock_output(tmp_path, alone=False):
            with pytest.raises(OutputExists):
                with lock_output(tmp_path):
                    pass
        assert first.is_alone()
        assert first.is_alone()


def test_one_of_several_is_not_alone(tmp_path: Path) -> None:
    with lock_output(tmp_path, alone=False), lock_output(tmp_path, alone=False) as second:
        assert not second.is_alone()


def test_nobody_is_certainly_alone_on_a_file_system_without_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is removed by one that is alone might be what another works on."""

    def fail(handle: int, kind: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", fail)
    with lock_output(tmp_path / "out", alone=False) as first:
        with lock_output(tmp_path / "out", alone=False) as second:
            assert not first.is_alone() and not second.is_alone()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("alone", [True, False])
def test_a_folder_that_was_made_and_left_empty_goes_away(tmp_path: Path, alone: bool) -> None:
    with lock_output(tmp_path / "a/b", alone):
        assert (tmp_path / "a/b").is_dir()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_others_hold_stays_until_the_last_has_left(tmp_path: Path) -> None:
    with lock_output(tmp_path / "out", alone=False):
        with lock_output(tmp_path / "out", alone=False):
            pass
        assert (tmp_path / "out").is_dir()
    assert not (tmp_path / "out").exists()


def test_a_second_holder_of_a_file_waits_for_the_first(tmp_path: Path) -> None:
    seen: list[str] = []

    def second() -> None:
        with hold_file(tmp_path / "w.lock"):
            seen.append("second")

    with hold_file(tmp_path / "w.lock"):
        thread = threading.Thread(target=second)
        thread.start()
        time.sleep(0.1)
        seen.append("first")
    thread.join(timeout=10)
    assert seen == ["first", "second"]
