"""What is wrong with a file that an asset path leads to, in one wording for all who look."""

import os

from pxr import Ar

__all__ = ["vdb_problem"]


def vdb_problem(authored_path: str, file_path: str) -> str:
    """Why a field's file cannot be opened, and what to do about it; "" when nothing is wrong.

    The text continues a sentence that names the path; only the path is looked at, not the file.

    Args:
        authored_path: as it stands in the layer.
        file_path: what it resolves to; "" for nothing.
    """
    if not authored_path and not file_path:
        return "wanted the path of a .vdb file"
    if authored_path.startswith("op:"):
        return (
            "that is a node inside Houdini, unknown outside it; "
            "write the volumes to files there (USD ROP) and use the stage it writes"
        )
    if Ar.IsPackageRelativePath(file_path) or Ar.IsPackageRelativePath(authored_path):
        package = Ar.SplitPackageRelativePathOuter(file_path or authored_path)[0]
        return (
            f"that is inside the package {package}, and OpenVDB reads plain files only; "
            "unpack it (a .usdz is a zip) and use the stage inside"
        )
    if not file_path:
        return "nothing is found there; check the path and that the files came along"
    if os.path.isdir(file_path):
        return f"{file_path} is a folder; wanted a .vdb file"
    if not os.path.isfile(file_path):
        return f"it resolves to {file_path}, where there is no file; check the resolver or the disk"
    return ""
