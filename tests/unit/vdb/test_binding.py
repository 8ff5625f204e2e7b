"""Which bindings are taken, and what is said when there are none that fit."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from usdsmoke.base.errors import BindingMissing
from usdsmoke.vdb import binding
from usdsmoke.vdb.binding import binding_version, find_binding

MODULE = """
LIBRARY_VERSION = (12, 0, 1)


class FloatGrid:
    def copyFromArray(self, values):
        {}
"""
FITTING = MODULE.format("pass")
MISFIT = MODULE.format("import os; os.abort()")


@pytest.fixture
def only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Makes modules of the given names and hides every other OpenVDB."""
    find_spec = importlib.util.find_spec

    def make(**modules: str) -> None:
        for name, code in modules.items():
            (tmp_path / f"{name}.py").write_text(code)
        monkeypatch.setattr(
            importlib.util,
            "find_spec",
            lambda name: find_spec(name) if name in modules else None,
        )

    monkeypatch.syspath_prepend(str(tmp_path))
    saved = {name: sys.modules.pop(name, None) for name in ("openvdb", "pyopenvdb")}
    find_binding.cache_clear()
    yield make
    find_binding.cache_clear()
    for name, module in saved.items():
        sys.modules.pop(name, None)
        if module is not None:
            sys.modules[name] = module


def test_new_name_is_taken_before_the_old_one(only) -> None:
    only(openvdb=FITTING, pyopenvdb="raise RuntimeError('the old one')")
    assert binding_version() == "openvdb 12.0.1"


def test_old_name_is_taken_where_there_is_no_new_one(only) -> None:
    only(pyopenvdb=FITTING)
    assert binding_version() == "pyopenvdb 12.0.1"


def test_missing_bindings_say_what_to_install(only) -> None:
    only()
    with pytest.raises(BindingMissing, match="pyopenvdb") as caught:
        find_binding()
    assert "python3-openvdb" in str(caught.value)


@pytest.mark.parametrize("numpy_version", ["1.26.4", "2.3.1"])
def test_bindings_that_do_not_load_say_why(
    only, monkeypatch: pytest.MonkeyPatch, numpy_version: str
) -> None:
    monkeypatch.setattr(np, "__version__", numpy_version)
    only(openvdb="raise ImportError('libtbb.so.12: cannot open shared object file')")
    with pytest.raises(BindingMissing, match=r"openvdb .*ImportError: libtbb\.so\.12"):
        find_binding()


def test_build_for_numpy_1_is_kept_away_from_numpy_2(only, monkeypatch: pytest.MonkeyPatch) -> None:
    """Such a build imports well and ends the process at the first array, as this stand-in does."""
    only(pyopenvdb=MISFIT)
    monkeypatch.setattr(np, "__version__", "2.3.1")
    with pytest.raises(BindingMissing, match=r'NumPy 2\.3\.1.*pip install "numpy<2"'):
        find_binding()
    assert "pyopenvdb" not in sys.modules


def test_build_for_numpy_2_is_welcome_under_numpy_2(only, monkeypatch: pytest.MonkeyPatch) -> None:
    only(openvdb=FITTING)
    monkeypatch.setattr(np, "__version__", "2.3.1")
    assert binding_version() == "openvdb 12.0.1"


def test_trial_import_that_hangs_counts_as_a_misfit(only, monkeypatch: pytest.MonkeyPatch) -> None:
    only(openvdb=FITTING)
    monkeypatch.setattr(np, "__version__", "2.0.0")

    def hang(*arguments, **settings):
        raise subprocess.TimeoutExpired("python", 60.0)

    monkeypatch.setattr(binding.subprocess, "run", hang)
    with pytest.raises(BindingMissing, match="numpy<2"):
        find_binding()
