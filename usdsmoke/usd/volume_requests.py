"""The settings that a Volume prim requests: the composed values of UsdSmokeStyleAPI, checked.

An attribute is used if it has an authored value, on a prim with the API applied. The API is looked
up by its name, so this process need not know the schema.
"""

import dataclasses
import os
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

from pxr import Sdf, Usd, UsdGeom, UsdVol

from usdsmoke.base.errors import AssetNotResolved, ConfigError, StageError, UsdSmokeError
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.base.volume import FrameControls, StyleRequest
from usdsmoke.config.setting_model import nearest
from usdsmoke.config.settings import checked_setting
from usdsmoke.usd.field_samples import field_targets, target_prim
from usdsmoke.usd.request_values import (
    CAMERA,
    MASK,
    REQUEST_ATTRIBUTES,
    REQUEST_PREFIX,
    STYLE_IMAGES,
    RequestAttribute,
    authoring_layer,
    forwarded_targets,
    image_paths,
    image_problem,
    plain_value,
    values_at,
)
from usdsmoke.usd.schema import STYLE_API
from usdsmoke.usd.values import value_at

_NAMES = (STYLE_IMAGES, CAMERA, MASK, *(row.name for row in REQUEST_ATTRIBUTES))


def has_request(volume: Usd.Prim) -> bool:
    """True if UsdSmokeStyleAPI is applied to a prim."""
    return STYLE_API in volume.GetPrimTypeInfo().GetAppliedAPISchemas()


def ignored_attributes(volume: Usd.Prim) -> tuple[str, ...]:
    """Requests that are ignored because the API is not applied."""
    return () if has_request(volume) else tuple(_authored(volume))


def read_request(
    volume: Usd.Prim, time_codes: Sequence[float], with_styles: bool = True
) -> tuple[StyleRequest, tuple[FrameControls, ...]]:
    """A Volume's request, and its animated settings at each timeCode.

    Time samples are interpolated as in USD. If an attribute changes over time, the request has its
    first value, or the largest for the strength; a change of any other attribute is an error.

    Args:
        time_codes: those that will be stylized, at least one.
        with_styles: True to look for its images; False if others replace them.

    Raises:
        ConfigError: an attribute is unknown, of a wrong type, out of range, or changes over time
            though it may not.
        AssetNotResolved: a style image is not found.
        StageError: a relationship does not have exactly one target.
    """
    if not has_request(volume):
        return StyleRequest(ignored=ignored_attributes(volume)), (FrameControls(),) * len(
            time_codes
        )
    for name in _authored(volume):
        _check_known(volume, name)
    settings: dict[str, dict[str, Any]] = {}
    controls = [FrameControls() for _ in time_codes]
    for row in _authored_rows(volume):
        values = _read_values(volume, row, time_codes)
        known = [value for value in values if value is not None]
        if not known:
            continue  # its time samples are blocked
        chosen = max(known) if row.control == "strength" else known[0]
        section, _, key = row.setting.partition(".")
        settings.setdefault(section, {})[key] = chosen
        if any(value != values[0] for value in values):
            changes: list[Any] = [tuple(v) if isinstance(v, list) else v for v in values]
            controls = [
                dataclasses.replace(control, **{row.control: change})
                for control, change in zip(controls, changes, strict=True)
            ]
    if mask := requested_mask(volume):
        settings.setdefault("stage", {})["mask"] = mask
    if camera := _target(volume, CAMERA):
        settings.setdefault("views", {})["camera"] = str(camera)
    styles = _read_styles(volume, time_codes) if with_styles else ()
    return StyleRequest(styles, settings), tuple(controls)


def requested_mask(volume: Usd.Prim) -> str:
    """The name of the relationship to the requested mask; "" if no mask is requested.

    It is the ``NAME`` of the Volume's own ``field:NAME`` that leads to the same field prim, or else
    the request's relationship itself.

    Raises:
        StageError: the request has several targets.
    """
    target = _target(volume, MASK) if has_request(volume) else None
    if target is None:
        return ""
    for name, targets in field_targets(volume).items():
        if targets == [target]:
            return name
    return MASK


def request_origins(volume: Usd.Prim) -> dict[str, dict[str, str]]:
    """Where each requested setting comes from: ``attribute`` (its path) and ``layer`` (its file).

    Returns:
        By the setting's dotted name, the style images by ``style``; empty without a request.
    """
    if not has_request(volume):
        return {}
    settings = {STYLE_IMAGES: "style", CAMERA: "views.camera", MASK: "stage.mask"}
    settings |= {row.name: row.setting for row in REQUEST_ATTRIBUTES}
    return {
        settings[name]: {
            "attribute": str(volume.GetPath().AppendProperty(name)),
            "layer": authoring_layer(volume.GetProperty(name)),
        }
        for name in _authored(volume)
        if name in settings
    }


def request_problems(volume: Usd.Prim) -> dict[str, str]:
    """What is wrong with a Volume's request and its targets, by the property's path.

    Animated attributes are checked at their time samples, all others at the default time.
    """
    path, found = volume.GetPath(), {}
    if not has_request(volume):
        return {}
    checks: list[tuple[str, Callable[[], object]]] = [
        (name, partial(_check_known, volume, name)) for name in _authored(volume)
    ]
    checks += [
        (row.name, partial(_read_values, volume, row, _samples(volume, row.name)))
        for row in _authored_rows(volume)
    ]
    checks.append((CAMERA, partial(_check_target, volume, CAMERA, UsdGeom.Camera)))
    checks.append((MASK, partial(_check_target, volume, MASK, UsdVol.OpenVDBAsset)))
    checks.append((STYLE_IMAGES, partial(_read_styles, volume, _samples(volume, STYLE_IMAGES))))
    for name, check in checks:
        try:
            check()
        except UsdSmokeError as error:
            found[str(path.AppendProperty(name))] = str(error)
    return found


def _samples(volume: Usd.Prim, name: str) -> Sequence[float]:
    return volume.GetAttribute(name).GetTimeSamples() or [0.0]


def _authored(volume: Usd.Prim) -> list[str]:
    """Names of all authored properties in the request's namespace."""
    properties = volume.GetAuthoredPropertiesInNamespace(REQUEST_PREFIX.rstrip(":"))
    return [
        item.GetName()
        for item in properties
        if (isinstance(item, Usd.Attribute) and _says_something(item))
        or (isinstance(item, Usd.Relationship) and forwarded_targets(item) != [])
    ]


def _says_something(item: Usd.Attribute) -> bool:
    """Also where a layer has a relationship in an attribute's place."""
    relationship = item.GetPrim().GetRelationship(item.GetName())
    return item.HasAuthoredValue() or bool(forwarded_targets(relationship))


def _authored_rows(volume: Usd.Prim) -> Iterable[RequestAttribute]:
    return [row for row in REQUEST_ATTRIBUTES if volume.GetAttribute(row.name).HasAuthoredValue()]


def _check_known(volume: Usd.Prim, name: str) -> None:
    if name not in _NAMES:
        raise ConfigError(
            f"unknown attribute {name} on <{volume.GetPath()}>: {STYLE_API} has none of that name. "
            f"{nearest(name, _NAMES)}"
        )
    is_relationship = bool(forwarded_targets(volume.GetRelationship(name)))
    if is_relationship != (name in (CAMERA, MASK)):
        found, kind = "a relationship", "an attribute"
        if not is_relationship:
            found, kind = kind, found
        raise ConfigError(f"<{volume.GetPath()}.{name}> is {found}. Author {kind} instead.")


def _read_values(volume: Usd.Prim, row: RequestAttribute, time_codes: Sequence[float]) -> list[Any]:
    """An attribute's value at each timeCode, checked; None where it is blocked."""
    where = f"<{volume.GetPath()}.{row.name}>"
    values = values_at(volume.GetAttribute(row.name), time_codes, plain_value)
    checked = []
    for code, value in zip(time_codes, values, strict=True):
        changes = value != values[0]
        place = f"{where} at timeCode {format_time_code(code)}" if changes else where
        if changes and not row.control:
            raise ConfigError(_may_not_change(where, code))
        checked.append(None if value is None else checked_setting(row.setting, value, place))
    return checked


def _may_not_change(where: str, time_code: float) -> str:
    varying = [row.name for row in REQUEST_ATTRIBUTES if row.control]
    return (
        f"{where} changes over time (at timeCode {format_time_code(time_code)}), but only "
        f"{', '.join(varying)} may. "
        "Author one value without time samples, or select other frames."
    )


def _read_styles(volume: Usd.Prim, time_codes: Sequence[float]) -> tuple[str, ...]:
    """The style images, absolute."""
    attribute = volume.GetAttribute(STYLE_IMAGES)
    if not attribute.HasAuthoredValue():
        return ()
    where = f"<{volume.GetPath()}.{STYLE_IMAGES}>"
    value = value_at(attribute, time_codes[0])
    if value is not None and not isinstance(value, (Sdf.AssetPath, Sdf.AssetPathArray)):
        raise ConfigError(f"{where} is {value!r}. Author images as asset[], as in [@./fire.png@].")
    found = values_at(attribute, time_codes, image_paths)
    for code, images in zip(time_codes, found, strict=True):
        if images != found[0]:
            raise ConfigError(_may_not_change(where, code))
    for resolved, authored in found[0] or ():
        if problem := image_problem(authored, resolved):
            layer = authoring_layer(attribute)
            raise AssetNotResolved(f"{where} names @{authored}@, authored in {layer}: {problem}")
    return tuple(os.path.abspath(resolved) for resolved, _ in found[0] or ())


def _target(volume: Usd.Prim, name: str) -> Sdf.Path | None:
    """The one target of a relationship; None when it has none."""
    relationship = volume.GetRelationship(name)
    targets = (forwarded_targets(relationship) or []) if relationship else []
    if len(targets) > 1:
        raise StageError(
            f"<{volume.GetPath()}.{name}> has {len(targets)} targets "
            f"({', '.join(f'<{target}>' for target in targets)}). Keep one."
        )
    return targets[0] if targets else None


def _check_target(volume: Usd.Prim, name: str, kind: type) -> None:
    """Refuse a relationship that does not lead to a prim of a kind; no target is no error."""
    target = _target(volume, name)
    if target is None:
        return
    where = f"<{volume.GetPath()}.{name}> leads to <{target}>"
    prim = target_prim(volume.GetStage(), [target])
    if prim is None:
        raise StageError(
            f"{where}, where there is no prim. Correct its target: a prim of type {kind.__name__}."
        )
    if not prim.IsA(kind):
        raise StageError(
            f"{where}, which is of type {prim.GetTypeName() or 'none'}. Correct its target: a prim "
            f"of type {kind.__name__}."
        )
