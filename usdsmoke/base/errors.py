"""All error classes of usdsmoke.

    UsdSmokeError
      ConfigError         also ValueError: a setting is unknown, of the wrong type or out of range
      StageError          the stage cannot be opened or lacks what is needed
        VolumeNotFound
        FieldNotFound
        AssetNotResolved
      GridError           a VDB file or grid cannot be used
        GridNotFound
        UnsupportedGrid
        DamagedFile
        GridTooLarge
        BindingMissing
      ImageError          a style image cannot be read
      FileUnreadable      any other file that a run reads, or has written, cannot be read
      FeatureError        the feature network's parameter file is missing or wrong
      ShapeError          also ValueError: two arrays do not fit together
      NonFiniteError      also ArithmeticError: NaN or infinity, reported where it first occurs
      PlanError           the scene does not fit the machine or its limits
      LayerError          the result cannot be written
        OutputExists
        WriteFailed
      ClusterError        a Dask cluster cannot be reached or used
      MissingPackage      a package that a command needs is not installed
      Interrupted         the user stopped the run

A message has two parts: what is wrong (what was found), and what to do.
"""

from collections.abc import Sequence

REFUSED = "the run would be refused"  # the beginning of a note in a plan


class UsdSmokeError(Exception):
    """Base of every named error; the command line prints its text and exits with 1.

    Args:
        message: what is wrong, and what to do.
        details: what only some readers want, such as hashes; printed with ``--verbose``.
    """

    def __init__(self, message: str = "", details: str = "") -> None:
        super().__init__(message)
        self.details = details


class ConfigError(UsdSmokeError, ValueError):
    """A setting is unknown, of the wrong type or out of range."""


class StageError(UsdSmokeError):
    """The stage cannot be opened or lacks what is needed."""


class VolumeNotFound(StageError):
    """No Volume prim at the given path, or none on the stage at all."""


class FieldNotFound(StageError):
    """A Volume lacks the field relationship or the field prim that is needed."""


class AssetNotResolved(StageError):
    """A field's file path is empty, does not resolve, or cannot be read from disk."""


class GridError(UsdSmokeError):
    """A VDB file or one of its grids cannot be used."""

    lacks_memory = False  # True: with more memory it might be used


class GridNotFound(GridError):
    """The file has no grid of that name and index; the message lists its grids."""


class UnsupportedGrid(GridError):
    """A level set, points, or a value type that smoke cannot be read from."""


class DamagedFile(GridError):
    """Not a VDB file, truncated, or so damaged that reading it fails, hangs or exhausts memory."""


class GridTooLarge(GridError):
    """The active bounding box does not fit the memory limit as a dense array."""

    lacks_memory = True


class BindingMissing(GridError):
    """OpenVDB's Python bindings are absent or do not fit the installed NumPy."""


class ImageError(UsdSmokeError):
    """An image file cannot be read or written, or holds nothing usable."""


class FileUnreadable(UsdSmokeError):
    """A file whose bytes are part of a run's record cannot be read."""


class FeatureError(UsdSmokeError):
    """The feature network's parameter file is missing, damaged or not the requested one."""


class ShapeError(UsdSmokeError, ValueError):
    """Two arrays, or an array and its description, do not fit together."""


class NonFiniteError(UsdSmokeError, ArithmeticError):
    """NaN or infinity where a finite number is needed."""


class PlanError(UsdSmokeError):
    """The scene needs more than the machine has or than the configured limits allow."""


class LayerError(UsdSmokeError):
    """The result cannot be written."""


class OutputExists(LayerError):
    """A result exists already, and replacing it was not requested."""


class WriteFailed(LayerError):
    """A file came back from disk different from what was written, or could not be written."""


class ClusterError(UsdSmokeError):
    """A Dask cluster cannot be reached or used, or lost its workers."""


class MissingPackage(UsdSmokeError):
    """A package that a command needs is not installed; the message says how to install it."""


class Interrupted(UsdSmokeError):
    """The user stopped the run; nothing half-made was left behind."""


_NO_MEMORY = ("can't allocate memory", "failed to map segment", "out of memory")


def lacks_memory(error: BaseException) -> bool:
    """Whether an error of Python, torch or the system's loader means that memory ran out."""
    kinds = (RuntimeError, ImportError, OSError)
    told = isinstance(error, kinds) and any(text in str(error) for text in _NO_MEMORY)
    return isinstance(error, MemoryError) or told


def count_text(count: int, noun: str) -> str:
    """A number with its noun, for messages.

    >>> count_text(1, "style image"), count_text(2, "style image")
    ('1 style image', '2 style images')
    """
    return f"{count} {noun}{'' if count == 1 else 's'}"


def others_advice(paths: Sequence[str]) -> str:
    """How to go on without a Volume that cannot be used, as a sentence with a space before it.

    >>> others_advice(["/World/smoke", "/World/fire"])
    ' Or use the others: --prim /World/smoke --prim /World/fire.'
    >>> others_advice([])
    ''
    """
    options = " ".join(f"--prim {path}" for path in paths)
    return f" Or use the others: {options}." if options else ""
