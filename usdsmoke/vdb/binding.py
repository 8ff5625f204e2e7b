"""Finding OpenVDB's Python bindings, and checking that they fit the installed NumPy.

OpenVDB 11 and later call the module ``openvdb``, 10 and earlier ``pyopenvdb``. The Boost.Python
builds of Debian and Ubuntu can be imported under another major version of NumPy, but crash the
interpreter at the first array. Under NumPy 2, a separate process therefore tries one array first.
"""

import functools
import importlib
import importlib.util
import os
import subprocess
import sys
from types import ModuleType

import numpy as np

from usdsmoke.base.errors import BindingMissing
from usdsmoke.base.machine import python_command

_MODULES = ("openvdb", "pyopenvdb")
_INSTALL = (
    "Install conda-forge's openvdb, or Debian's python3-openvdb and link its pyopenvdb*.so into "
    "this environment, or run inside Houdini or Blender."
)
_TRIAL = (
    "import numpy, {0}; print('loaded', flush=True); "
    "{0}.FloatGrid().copyFromArray(numpy.ones((2, 2, 2), numpy.float32))"
)
_TRIAL_LIMIT_S = 60.0


def binding_name() -> str:
    """The name of OpenVDB's Python module, which is not imported.

    Raises:
        BindingMissing: neither ``openvdb`` nor ``pyopenvdb`` is installed.
    """
    for name in _MODULES:
        if importlib.util.find_spec(name) is not None:
            return name
    raise BindingMissing(
        f"the Python bindings of OpenVDB are not installed for {sys.executable} (neither "
        f"{' nor '.join(_MODULES)}). {_INSTALL}"
    )


@functools.cache
def find_binding() -> ModuleType:
    """OpenVDB's Python module, imported.

    Raises:
        BindingMissing: neither ``openvdb`` nor ``pyopenvdb`` is there, it does not load, or it was
            built for another NumPy.
    """
    name = binding_name()
    if int(np.__version__.partition(".")[0]) >= 2:
        _check_array(name)
    try:
        return importlib.import_module(name)
    except Exception as error:  # whatever a broken extension raises while it loads
        raise BindingMissing(
            f"the OpenVDB bindings {name} do not load ({type(error).__name__}: {error}). {_INSTALL}"
        ) from error


def binding_version() -> str:
    """Name and version of the bindings, such as ``pyopenvdb 10.0.1``.

    Raises:
        BindingMissing: see ``find_binding``.
    """
    binding = find_binding()
    return f"{binding.__name__} {'.'.join(str(number) for number in binding.LIBRARY_VERSION)}"


def _check_array(name: str) -> None:
    """Copy an array in another process, because a mismatch crashes the process silently."""
    search = os.pathsep.join(entry for entry in sys.path if entry)
    try:
        trial = subprocess.run(
            python_command(_TRIAL.format(name)),
            env={**os.environ, "PYTHONPATH": search},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_TRIAL_LIMIT_S,
            check=False,
        )
        # If the module did not even load, find_binding reports why.
        fits = trial.returncode == 0 or b"loaded" not in trial.stdout
    except subprocess.TimeoutExpired:
        fits = False
    if not fits:
        raise BindingMissing(
            f"the OpenVDB bindings {name} were built for NumPy 1, and this is NumPy "
            f'{np.__version__}. Run: python -m pip install "numpy<2"'
        )
