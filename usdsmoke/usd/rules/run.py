"""All validators that there are, ours and USD's, over a stage or layer, as one sorted list."""

import os
import re

from pxr import Usd, UsdValidation

from usdsmoke.usd.diagnostics import captured_diagnostics, open_quietly
from usdsmoke.usd.rules.findings import Finding, Severity
from usdsmoke.usd.rules.registry import PREFIX, register_validators
from usdsmoke.usd.schema import late_note, register_schema

__all__ = ["validate", "validate_stage"]

_SEVERITIES = {
    UsdValidation.ValidationErrorType.Error: Severity.ERROR,
    UsdValidation.ValidationErrorType.Warn: Severity.WARN,
    UsdValidation.ValidationErrorType.Info: Severity.INFO,
}
# Errors of this machine's installation rather than of the stage: a renderer's shader is unknown
# wherever that renderer is not installed.
_OF_THE_INSTALLATION = {"usdShadeValidators:ShaderSdrCompliance.MissingShaderIdInRegistry"}
_TIME = re.compile(r"timeCode (-?[0-9.]+(?:e[+-]?\d+)?): ")


def validate(file_path: str | os.PathLike[str]) -> list[Finding]:
    """Everything that any validator says about a stage or layer, worst first, each thing once.

    A layer is looked at as the stage that it is by itself. Severities are the validators' own, but
    for a shader that no installed renderer knows, which is a warning. Files are opened for their
    headers; those that usdsmoke wrote are read whole, each in a process of its own, to compare
    their hashes.

    Raises:
        StageError: the file is missing, of no USD format, or cannot be parsed.
    """
    register_schema()
    return validate_stage(open_quietly(os.fspath(file_path)))


def validate_stage(stage: Usd.Stage) -> list[Finding]:
    """``validate`` for a stage that is open, as it is composed now, unsaved edits included.

    Args:
        stage: any; only what is loaded is seen.
    """
    register_validators()
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    with captured_diagnostics():  # some stock validators also warn on stderr
        errors = UsdValidation.ValidationContext(validators).Validate(stage)
        findings = {_to_finding(error) for error in errors}
    if note := late_note():
        findings.add(Finding(Severity.INFO, "SchemaNotRegistered", "", None, note))
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


def _to_finding(error: UsdValidation.ValidationError) -> Finding:
    message = " ".join(error.GetMessage().split())
    match = _TIME.match(message)
    identifier = str(error.GetIdentifier())
    is_ours = identifier.startswith(PREFIX)
    severity = _SEVERITIES.get(error.GetType(), Severity.INFO)
    return Finding(
        severity=Severity.WARN if identifier in _OF_THE_INSTALLATION else severity,
        rule=str(error.GetName()) if is_ours else identifier,
        prim_path=_place(error),
        time_code=float(match[1]) if is_ours and match else None,
        message=message[match.end() :] if is_ours and match else message,
    )


def _place(error: UsdValidation.ValidationError) -> str:
    """The path of the first prim or property that is meant; empty for layers and stages."""
    for site in error.GetSites():
        if not site.IsValid():
            continue
        if site.IsProperty():
            return str(site.GetProperty().GetPath())
        if site.IsPrim():
            path = str(site.GetPrim().GetPath())
            return "" if path == "/" else path
    return ""
