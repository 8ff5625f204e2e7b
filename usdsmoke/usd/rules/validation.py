"""Validators of usdsmoke in USD's registry; all validators over one stage, as one sorted list.

OpenUSD takes validators from Python since 26.05. ``UsdValidation`` is loaded inside functions, so
that everything else also works with an older OpenUSD.
"""

import difflib
import os
import re
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from pxr import Gf, Sdf, Tf, Usd

from usdsmoke.base.errors import ConfigError, StageError
from usdsmoke.base.time_codes import format_time_code
from usdsmoke.usd.diagnostics import (
    captured_diagnostics,
    check_is_stage,
    decoded_text,
    open_quietly,
    readable_values,
)
from usdsmoke.usd.rules import field_rules, result_rules, volume_rules
from usdsmoke.usd.rules.facts import Finding, Problem, Severity
from usdsmoke.usd.rules.fixers import fixers_of
from usdsmoke.usd.schema import LOOK_API, late_note, register_schema

if TYPE_CHECKING:
    from pxr import UsdValidation

PREFIX = "usdsmokeValidators:"

PrimRule = Callable[[Usd.Prim, Gf.Interval], list[Problem]]

_VOLUME_RULES: dict[str, tuple[PrimRule, str]] = {
    "VolumeExtentMissing": (volume_rules.check_extent, "A Volume has an extent."),
    "FieldTargetInvalid": (field_rules.check_targets, "Field relationships lead to field prims."),
    "FieldKindUnsupported": (
        field_rules.check_kinds,
        "The density, and the velocity if there is one, are OpenVDBAssets.",
    ),
    "FieldFileMissing": (field_rules.check_files, "Field files exist and are VDB files."),
    "GridMissing": (field_rules.check_grids, "Files have the grids that their fields name."),
    "GridUnsupported": (field_rules.check_density, "The density's grids are fog volumes."),
    "FieldTypeMismatch": (field_rules.check_types, "fieldDataType describes the grid."),
    "FieldClassMismatch": (field_rules.check_classes, "fieldClass describes the grid."),
    "FieldTokenUnknown": (field_rules.check_tokens, "Field tokens are those the schema allows."),
    "FrameGap": (field_rules.check_gaps, "The numbered files of a sequence have no gaps."),
    "AbsolutePath": (field_rules.check_absolute_paths, "File paths are relative."),
    "MixedFilesPerVolume": (volume_rules.check_one_file, "A Volume's fields share one file."),
    "FieldNameMismatch": (
        volume_rules.check_one_name,
        "Each field's relationship is named after its grid.",
    ),
    "GridTransformMismatch": (
        volume_rules.check_one_place,
        "The grids of a Volume have the same transform.",
    ),
    "FieldPlaceDiffers": (
        volume_rules.check_field_place,
        "A field prim has the same transform as its Volume.",
    ),
    "LookHidden": (
        volume_rules.check_look_seen,
        "The material of a Volume with a look reads the look's colours.",
    ),
    "LookOverridden": (
        result_rules.check_look_strongest,
        "The files of a look are not replaced by a stronger layer.",
    ),
    "LookUnits": (
        volume_rules.check_look_units,
        "A look is referenced in the units that it was made for.",
    ),
    "RequestInvalid": (volume_rules.check_request, "A Volume's style request can be read."),
    "RequestNotApplied": (
        volume_rules.check_request_applied,
        "Style attributes are ignored unless UsdSmokeStyleAPI is applied.",
    ),
    "LookStale": (
        result_rules.check_stale,
        "The source has the variants and files that the look was made from.",
    ),
    "GridHashMismatch": (
        result_rules.check_field_results,
        "The grids in a file that usdsmoke wrote still match the hashes in the file.",
    ),
}
_PRIM_RULES: dict[str, tuple[PrimRule, str]] = {
    "RequestMisplaced": (
        volume_rules.check_request_placed,
        "UsdSmokeStyleAPI is applied to Volumes only.",
    ),
}
_STAGE_RULES = {
    "LookWithoutVolume": (
        result_rules.check_volumes_of_looks,
        "The Volumes of a look are on the stage.",
    )
}
_LAYER_RULES = {
    "ResultChanged": (
        result_rules.check_layer_results,
        "The files of a look layer still match the hashes in the layer.",
    )
}
# These errors are about the installed renderers, not about the stage.
_SDR = "usdShadeValidators:ShaderSdrCompliance."
_OF_THE_INSTALLATION = {
    f"{_SDR}MissingShaderIdInRegistry",
    f"{_SDR}MissingSourceTypeInRegistry",
}
_OPENING = "usdUtilsValidators:"  # validators that open all layers which a stage names
_SCHEMA_NOTE = "SchemaNotRegistered"
_TIME = re.compile(r"timeCode (-?[0-9.]+(?:e[+-]?\d+)?): ")


def register_validators() -> list[str]:
    """Register the rules with UsdValidation; calling it again does no harm.

    Returns:
        The validators' names. Each finding's text begins with its timeCode where it has one, since
        UsdValidation carries no time itself.

    Raises:
        StageError: OpenUSD is older than 26.05.
    """
    module = _validation()
    registry = module.ValidationRegistry()
    for name, (rule, doc) in (_VOLUME_RULES | _PRIM_RULES).items():
        if not registry.HasValidator(PREFIX + name):
            metadata = module.ValidatorMetadata(
                name=PREFIX + name,
                keywords=["usdsmoke", "UsdVol"],
                doc=doc,
                schemaTypes=["UsdVolVolume"] if name in _VOLUME_RULES else [],
                isTimeDependent=True,
            )
            fixers = fixers_of(name, module)  # none in OpenUSD older than 26.11
            arguments = (metadata, _prim_task(name, rule), *([fixers] if fixers else []))
            registry.RegisterPrimValidator(*arguments)
    tasks: dict[str, tuple[Callable[..., None], Any, str]] = {
        name: (registry.RegisterStageValidator, _stage_task(name, stage_rule), doc)
        for name, (stage_rule, doc) in _STAGE_RULES.items()
    }
    for name, (layer_rule, doc) in _LAYER_RULES.items():
        tasks[name] = (registry.RegisterLayerValidator, _layer_task(name, layer_rule), doc)
    for name, (register, task, doc) in tasks.items():
        if not registry.HasValidator(PREFIX + name):
            metadata = module.ValidatorMetadata(
                name=PREFIX + name, keywords=["usdsmoke", "UsdVol"], doc=doc
            )
            register(metadata, task)
    return [PREFIX + name for name in _own_rules()]


def _own_rules() -> list[str]:
    return [*_VOLUME_RULES, *_PRIM_RULES, *_STAGE_RULES, *_LAYER_RULES]


def check_rules(names: Iterable[str]) -> None:
    """Refuse names that no finding can have.

    Args:
        names: as in ``Finding.rule``.

    Raises:
        ConfigError: a name is unknown.
        StageError: OpenUSD is older than 26.05.
    """
    names = list(names)
    if not names:
        return
    register_validators()
    known = {_SCHEMA_NOTE}
    for validator in _validation().ValidationRegistry().GetOrLoadAllValidators():
        metadata = validator.GetMetadata()
        known.add(str(metadata.name).removeprefix(PREFIX))
    for name in names:
        # USD's own findings are named VALIDATOR.ERROR; a validator does not list its errors.
        if name not in known and name.rpartition(".")[0] not in known:
            close = difflib.get_close_matches(name, sorted(known), n=3)
            advice = f"Did you mean {' or '.join(close)}?" if close else ""
            if not close:
                advice = (
                    "Rules of OpenUSD have two parts, as they are printed: VALIDATOR.ERROR. "
                    f"usdsmoke's own rules: {', '.join(sorted(_own_rules()))}."
                )
            raise ConfigError(f"there is no rule {name!r}. {advice}")


@readable_values()
def validate(stage: str | os.PathLike[str] | Usd.Stage) -> list[Finding]:
    """What all validators find on a stage or in a layer, worst first, each finding once.

    Severities are the validators' own, but a shader that no installed renderer knows is a warning,
    and no finding in the material of a look, which has shaders for several renderers.
    Files are opened for their headers. Files that usdsmoke wrote are read whole, each in a process
    of its own, to compare their hashes.

    Args:
        stage: a USD file, or an open stage, which is checked as it is composed now, with its
            unsaved edits. Only what is loaded is checked.

    Raises:
        StageError: the file is missing, of no USD format, or cannot be parsed; or OpenUSD is older
            than 26.05.
    """
    register_schema()
    register_validators()
    check_is_stage(stage)
    if not isinstance(stage, Usd.Stage):
        stage = open_quietly(os.fspath(stage))
    module = _validation()
    validators = module.ValidationRegistry().GetOrLoadAllValidators()
    with captured_diagnostics():  # some validators of USD also warn on stderr
        errors = _all_errors(module, validators, stage)
        findings = {_to_finding(error) for error in errors if not _is_of_a_look(error)}
    if note := late_note():
        findings.add(Finding(Severity.INFO, _SCHEMA_NOTE, "", None, note))
    order = list(Severity)
    return sorted(
        findings,
        key=lambda item: (
            order.index(item.severity),
            item.prim_path,
            item.rule,
            -1e300 if item.time_code is None else item.time_code,
            item.message,
        ),
    )


def _all_errors(
    module: Any, validators: list["UsdValidation.Validator"], stage: Usd.Stage
) -> list["UsdValidation.ValidationError"]:
    """What the validators find; without those that open layers, where one cannot be opened.

    USD's validator of composition names such a layer. A value that cannot be read fails again.
    """
    try:
        return list(module.ValidationContext(validators).Validate(stage))
    except Tf.ErrorException:
        others = [
            item for item in validators if not str(item.GetMetadata().name).startswith(_OPENING)
        ]
        return list(module.ValidationContext(others).Validate(stage))


@readable_values()
def mend(stage: Usd.Stage) -> list[Finding]:
    """Apply the fixers of all findings of ours at a stage's edit target, whose layer is saved.

    Returns:
        The findings that were mended.

    Raises:
        StageError: OpenUSD is older than 26.11, or a value cannot be read.
    """
    register_schema()
    register_validators()
    module = _validation()
    if not hasattr(module, "ValidationFixer"):
        raise StageError(
            "mending needs OpenUSD 26.11 or later. Install a newer usd-core, or correct the "
            "findings of 'usdsmoke validate' by hand."
        )
    validators = module.ValidationRegistry().GetOrLoadAllValidators()
    mended, target = [], stage.GetEditTarget()
    with captured_diagnostics():
        for error in _all_errors(module, validators, stage):
            for fixer in error.GetFixersByKeywords(["usdsmoke"]):
                if fixer.CanApplyFix(error, target, Usd.TimeCode.Default()):
                    if fixer.ApplyFix(error, target, Usd.TimeCode.Default()):
                        mended.append(_to_finding(error))
    return mended


def _validation() -> "UsdValidation":
    """The module UsdValidation, if it takes validators from Python."""
    try:
        from pxr import UsdValidation
    except ImportError:
        UsdValidation = None
    if not hasattr(getattr(UsdValidation, "ValidationRegistry", None), "RegisterPrimValidator"):
        major, minor = Usd.GetVersion()[1:]
        raise StageError(
            f"validation needs OpenUSD 26.05 or later (found {major}.{minor:02}). Install a newer "
            "usd-core to validate; everything else works with this one."
        )
    return UsdValidation


def _prim_task(
    name: str, rule: PrimRule
) -> Callable[
    [Usd.Prim, "UsdValidation.ValidationTimeRange"], list["UsdValidation.ValidationError"]
]:
    def task(
        prim: Usd.Prim, time_range: "UsdValidation.ValidationTimeRange"
    ) -> list["UsdValidation.ValidationError"]:
        return [
            _error(name, item, (prim.GetStage(), Sdf.Path(item.prim_path)))
            for item in rule(prim, time_range.GetInterval())
        ]

    return task


def _stage_task(
    name: str, rule: Callable[[Usd.Stage], list[Problem]]
) -> Callable[
    [Usd.Stage, "UsdValidation.ValidationTimeRange"], list["UsdValidation.ValidationError"]
]:
    def task(
        stage: Usd.Stage, _time_range: "UsdValidation.ValidationTimeRange"
    ) -> list["UsdValidation.ValidationError"]:
        return [_error(name, item, (stage, Sdf.Path(item.prim_path))) for item in rule(stage)]

    return task


def _layer_task(
    name: str, rule: Callable[[Sdf.Layer], list[Problem]]
) -> Callable[[Sdf.Layer], list["UsdValidation.ValidationError"]]:
    def task(layer: Sdf.Layer) -> list["UsdValidation.ValidationError"]:
        return [_error(name, item, (layer, Sdf.Path.absoluteRootPath)) for item in rule(layer)]

    return task


def _error(
    name: str, problem: Problem, site: tuple[Usd.Stage | Sdf.Layer, Sdf.Path]
) -> "UsdValidation.ValidationError":
    from pxr import UsdValidation

    kind = {severity: kind for kind, severity in _severities().items()}[problem.severity]
    text = problem.message
    if problem.time_code is not None:
        text = f"timeCode {format_time_code(problem.time_code)}: {text}"
    sites = [UsdValidation.ValidationErrorSite(*site)]
    return UsdValidation.ValidationError(name, kind, sites, text)


def _severities() -> dict["UsdValidation.ValidationErrorType", Severity]:
    from pxr import UsdValidation

    kinds = UsdValidation.ValidationErrorType
    return {kinds.Error: Severity.ERROR, kinds.Warn: Severity.WARN, kinds.Info: Severity.INFO}


def _to_finding(error: "UsdValidation.ValidationError") -> Finding:
    message = " ".join(decoded_text(error.GetMessage).split())
    match = _TIME.match(message)
    identifier = str(error.GetIdentifier())
    is_ours = identifier.startswith(PREFIX)
    severity = _severities().get(error.GetType(), Severity.INFO)
    return Finding(
        severity=Severity.WARN if identifier in _OF_THE_INSTALLATION else severity,
        rule=str(error.GetName()) if is_ours else identifier,
        prim_path=_place(error),
        time_code=float(match[1]) if is_ours and match else None,
        message=message[match.end() :] if is_ours and match else message,
    )


def _is_of_a_look(error: "UsdValidation.ValidationError") -> bool:
    """True for a look's own shader that is for a renderer which is not installed."""
    path = Sdf.Path(_place(error)).GetPrimPath()
    if str(error.GetIdentifier()) not in _OF_THE_INSTALLATION or path.isEmpty:
        return False
    volume = error.GetSites()[0].GetStage().GetPrimAtPath(path.GetParentPath().GetParentPath())
    return bool(volume) and LOOK_API in volume.GetPrimTypeInfo().GetAppliedAPISchemas()


def _place(error: "UsdValidation.ValidationError") -> str:
    """The path of the first prim or property concerned; empty for layers and stages."""
    for site in error.GetSites():
        if not site.IsValid():
            continue
        if site.IsProperty():
            return str(site.GetProperty().GetPath())
        if site.IsPrim():
            path = str(site.GetPrim().GetPath())
            return "" if path == "/" else path
    return ""
