"""A Volume's field relationships, and what a field prim shows at a time, as USD resolves it."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from pxr import Gf, Sdf, Usd

from usdsmoke.usd.values import authored_path, typed_value_at, value_at

FIELD_PREFIX = "field:"


def field_targets(volume: Usd.Prim) -> dict[str, list[Sdf.Path]]:
    """Forwarded targets of every field relationship by its name without the prefix.

    Differs from ``UsdVol.Volume.GetFieldPaths``: names with further colons stay whole, and
    relationships without or with several targets are kept, so that they can be reported.
    """
    return {
        relationship.GetName().removeprefix(FIELD_PREFIX): list(relationship.GetForwardedTargets())
        for relationship in volume.GetRelationships()
        if relationship.GetName().startswith(FIELD_PREFIX)
    }


def target_prim(stage: Usd.Stage, targets: Sequence[Sdf.Path]) -> Usd.Prim | None:
    """The prim at the one target of a relationship, of any type.

    Returns:
        None if there is no target or several, or if the target is no prim of the stage.
    """
    if len(targets) != 1 or not targets[0].IsPrimPath():
        return None
    return stage.GetPrimAtPath(targets[0]) or None


@dataclass(frozen=True)
class FieldSample:
    """What a field prim shows at one time, files unchecked."""

    time_code: float | None  # None: without a time
    authored_path: str  # as the layer spells it
    file_path: str  # resolved; "" if it does not resolve
    has_path: bool  # False: filePath has no value, and nothing is shown
    blocked: bool  # True: filePath is authored, but has no value at this time
    grid_name: str
    grid_index: int | None


class FieldSamples:
    """The file and the grid of a field prim over time.

    USD holds the values of ``filePath``, ``fieldName`` and ``fieldIndex`` between time samples.
    """

    def __init__(self, prim: Usd.Prim) -> None:
        """Args: prim: a FieldAsset, such as an OpenVDBAsset."""
        self._file = prim.GetAttribute("filePath")
        self._grid = (prim.GetAttribute("fieldName"), prim.GetAttribute("fieldIndex"))

    def at(self, time_code: float | None) -> FieldSample:
        """What is shown at any time; None asks for the default value."""
        code = usd_time(time_code)
        asset = typed_value_at(self._file, code, Sdf.AssetPath)
        return FieldSample(
            time_code=time_code,
            authored_path=authored_path(asset) if asset else "",
            file_path=str(asset.resolvedPath) if asset else "",
            has_path=asset is not None,
            blocked=asset is None and self._file.HasAuthoredValue(),
            grid_name=typed_value_at(self._grid[0], code, str) or "",
            grid_index=typed_value_at(self._grid[1], code, int),
        )

    def changes(self) -> list[float]:
        """Ascending timeCodes at which the grid may change; none if nothing is animated.

        These are the time samples of ``filePath``, and those of ``fieldName`` and ``fieldIndex``
        whose values differ from the values before: one file can hold the grids of many timeCodes.
        """
        file_codes = set(self._file.GetTimeSamples())
        grid_codes = sorted({code for item in self._grid for code in item.GetTimeSamples()})
        grids = [tuple(value_at(item, code) for item in self._grid) for code in grid_codes]
        if not file_codes and len(set(grids)) < 2:
            return []
        changes = {
            code
            for n, code in enumerate(grid_codes)
            if (n and grids[n] != grids[n - 1]) or (n == 0 and not file_codes)
        }
        return sorted(file_codes | changes)

    def stretch(self, time_code: float) -> tuple[float, float]:
        """How many times slower than in its layer the file's motion is shown.

        Layer offsets of sublayers, references and payloads are multiplied. Of value clips nothing
        is known: 1.

        Returns:
            stage timeCodes a timeCode of the layer, and stage seconds a second of the layer.
        """
        rate = self._file.GetStage().GetTimeCodesPerSecond()
        for attribute in (self._file, *filter(_varies, self._grid)):
            stack = attribute.GetPropertyStackWithLayerOffsets(Usd.TimeCode(time_code))
            for spec, offset in stack:
                if spec.HasInfo("timeSamples"):
                    scale = float(offset.scale)
                    return scale, scale * float(spec.layer.timeCodesPerSecond) / rate
        return 1.0, 1.0

    def inside(self, interval: Gf.Interval) -> tuple[FieldSample, ...]:
        """One entry for every time sample in an interval; one entry if there is none."""
        attributes = (self._file, *self._grid)
        codes = sorted({code for item in attributes for code in item.GetTimeSamples()})
        found = [code for code in codes if interval.Contains(code)]
        return tuple(self.at(code) for code in found or codes[:1] or [None])


def _varies(attribute: Usd.Attribute) -> bool:
    """Whether an attribute has time samples of several values, and no stronger default."""
    return len({value_at(attribute, code) for code in attribute.GetTimeSamples()}) > 1


def usd_time(time_code: float | None) -> Usd.TimeCode:
    """USD's time code; None is the default time."""
    return Usd.TimeCode.Default() if time_code is None else Usd.TimeCode(time_code)


def held_time_code(time_codes: Sequence[float], time_code: float) -> float:
    """The one of ascending ``time_codes`` whose value USD holds at ``time_code``.

    >>> held_time_code((1.0, 4.0), 3.0), held_time_code((1.0, 4.0), 0.0)
    (1.0, 1.0)
    """
    return time_codes[max(bisect_right(time_codes, time_code) - 1, 0)]
