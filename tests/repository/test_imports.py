"""What importing a module, or asking for help, loads: measured in a fresh interpreter."""

import subprocess
import sys

from tests.fixtures.import_graph import PACKAGE, PROJECT, read_modules

OPENVDB = {"openvdb", "pyopenvdb"}
MODULES = read_modules()


def loaded_packages(code: str) -> set[str]:
    """Top-level packages that are loaded after ``code`` ran in a fresh interpreter."""
    report = "\nimport sys\nprint('\\nLOADED', *{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run(
        [sys.executable, "-c", code + report], capture_output=True, text=True, cwd=PROJECT
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.rsplit("LOADED", 1)[1].split())


def test_importing_the_package_loads_nothing_heavy() -> None:
    assert not loaded_packages("import usdsmoke") & {
        "torch",
        "pxr",
        "numpy",
        *OPENVDB,
    }


def test_help_of_inspect_loads_no_torch() -> None:
    code = """
import sys
from usdsmoke.ui.cli.main import main
sys.argv = ["usdsmoke", "inspect", "--help"]
try:
    main()
except SystemExit:
    pass
"""
    assert not loaded_packages(code) & {"torch", "pxr", *OPENVDB}


def test_importing_the_core_loads_neither_usd_nor_openvdb() -> None:
    core = [name for name in MODULES if name.startswith("core")]
    assert core
    code = "\n".join(f"import {PACKAGE.name}.{name}" for name in core)
    assert not loaded_packages(code) & {"pxr", *OPENVDB}
