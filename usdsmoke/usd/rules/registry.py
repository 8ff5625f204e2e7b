"""The rules as validators in UsdValidation's registry, next to those that ship with USD."""

from collections.abc import Callable

from pxr import Sdf, Usd, UsdValidation

from usdsmoke.base.time_codes import format_time_code
from usdsmoke.usd.rules import field_rules, request_rules, result_rules, volume_rules
from usdsmoke.usd.rules.findings import Problem, Severity

__all__ = ["PREFIX", "register_validators"]

PREFIX = "usdsmokeValidators:"

PrimRule = Callable[[Usd.Prim, UsdValidation.ValidationTimeRange], list[Problem]]

_VOLUME_RULES: dict[str, tuple[PrimRule, str]] = {
    "VolumeExtentMissing": (volume_rules.check_extent, "A Volume has an extent."),
    "FieldTargetInvalid": (field_rules.check_targets, "Field relationships lead to field prims."),
    "FieldFileMissing": (field_rules.check_files, "Field files are there and are VDB files."),
    "GridMissing": (field_rules.check_grids, "Files have the grids that their fields name."),
    "FieldTypeMismatch": (field_rules.check_types, "fieldDataType describes the grid."),
    "FieldClassMismatch": (field_rules.check_classes, "fieldClass describes the grid."),
    "FieldTokenUnknown": (field_rules.check_tokens, "Field tokens are those the schema allows."),
    "FrameGap": (field_rules.check_gaps, "Files follow one another without holes."),
    "AbsolutePath": (field_rules.check_absolute_paths, "File paths are relative."),
    "MixedFilesPerVolume": (volume_rules.check_one_file, "A Volume's fields share one file."),
    "FieldNameMismatch": (volume_rules.check_one_name, "Relationship and grid share one name."),
    "GridTransformMismatch": (volume_rules.check_one_place, "A Volume's fields share voxels."),
    "RequestInvalid": (request_rules.check_request, "What a Volume asks for can be read."),
    "RequestNotApplied": (
        request_rules.check_request_applied,
        "What a Volume asks for counts, because UsdSmokeStyleAPI is applied.",
    ),
    "GridHashMismatch": (
        result_rules.check_shown_results,
        "Files with a hash of usdsmoke's hold what they were written with.",
    ),
}
_PRIM_RULES: dict[str, tuple[PrimRule, str]] = {
    "RequestMisplaced": (
        request_rules.check_request_placed,
        "UsdSmokeStyleAPI is applied to Volumes alone.",
    ),
}
_LAYER_RULES = {
    "ResultChanged": (
        result_rules.check_layer_results,
        "The files of a look layer hold what the layer recorded of them.",
    )
}


def register_validators() -> list[str]:
    """Make the rules known to UsdValidation; again and again without harm.

    Returns:
        The validators' names. Each finding's text begins with its timeCode where it has one, since
        UsdValidation carries no time itself.
    """
    registry = UsdValidation.ValidationRegistry()
    for name, (rule, doc) in (_VOLUME_RULES | _PRIM_RULES).items():
        if not registry.HasValidator(PREFIX + name):
            metadata = UsdValidation.ValidatorMetadata(
                name=PREFIX + name,
                keywords=["usdsmoke", "UsdVol"],
                doc=doc,
                schemaTypes=["UsdVolVolume"] if name in _VOLUME_RULES else [],
                isTimeDependent=True,
            )
            registry.RegisterPrimValidator(metadata, _prim_task(name, rule))
    for name, (layer_rule, doc) in _LAYER_RULES.items():
        if not registry.HasValidator(PREFIX + name):
            metadata = UsdValidation.ValidatorMetadata(
                name=PREFIX + name, keywords=["usdsmoke", "UsdVol"], doc=doc
            )
            registry.RegisterLayerValidator(metadata, _layer_task(name, layer_rule))
    return [PREFIX + name for name in (*_VOLUME_RULES, *_PRIM_RULES, *_LAYER_RULES)]


def _prim_task(
    name: str, rule: PrimRule
) -> Callable[[Usd.Prim, UsdValidation.ValidationTimeRange], list[UsdValidation.ValidationError]]:
    def task(
        prim: Usd.Prim, time_range: UsdValidation.ValidationTimeRange
    ) -> list[UsdValidation.ValidationError]:
        stage = prim.GetStage()
        return [
            _error(name, item, UsdValidation.ValidationErrorSite(stage, Sdf.Path(item.prim_path)))
            for item in rule(prim, time_range)
        ]

    return task


def _layer_task(
    name: str, rule: Callable[[Sdf.Layer], list[Problem]]
) -> Callable[[Sdf.Layer], list[UsdValidation.ValidationError]]:
    def task(layer: Sdf.Layer) -> list[UsdValidation.ValidationError]:
        site = UsdValidation.ValidationErrorSite(layer, Sdf.Path.absoluteRootPath)
        return [_error(name, item, site) for item in rule(layer)]

    return task


def _error(
    name: str, problem: Problem, site: UsdValidation.ValidationErrorSite
) -> UsdValidation.ValidationError:
    kinds = {
        Severity.ERROR: UsdValidation.ValidationErrorType.Error,
        Severity.WARN: UsdValidation.ValidationErrorType.Warn,
        Severity.INFO: UsdValidation.ValidationErrorType.Info,
    }
    text = problem.message
    if problem.time_code is not None:
        text = f"timeCode {format_time_code(problem.time_code)}: {text}"
    return UsdValidation.ValidationError(name, kinds[problem.severity], [site], text)
