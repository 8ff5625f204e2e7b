"""Versions of what a result depends on, told without loading any of it."""

import platform
from importlib.metadata import PackageNotFoundError, version

__all__ = ["package_versions", "platform_name"]

_PACKAGES = ("usd-core", "torch", "numpy")


def package_versions() -> dict[str, str]:
    """Versions of Python and of the packages that a result depends on, OpenVDB's apart."""
    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # a USD or torch of another origin, without a wheel's record
            versions[name] = "unknown"
    return versions


def platform_name() -> str:
    """System and processor family, such as ``Linux x86_64``; nothing that names the machine."""
    return f"{platform.system()} {platform.machine()}"
