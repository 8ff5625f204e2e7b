"""Checks of volumes that USD's own validators do not make.

- `validation`: registers the rules with UsdValidation; runs all validators over a stage
- `facts`: what rules look at, and what they find
- `field_rules`: FieldTargetInvalid, FieldKindUnsupported, FieldFileMissing, GridMissing,
  GridUnsupported, FieldTypeMismatch, FieldClassMismatch, FieldTokenUnknown, FrameGap, AbsolutePath
- `volume_rules`: VolumeExtentMissing, MixedFilesPerVolume, FieldNameMismatch,
  GridTransformMismatch, FieldPlaceDiffers, RequestInvalid, RequestNotApplied, RequestMisplaced
- `fixers`: what can be mended without a decision
- `staleness`: whether the source has moved on since a look was made
- `result_rules`: GridHashMismatch, LookOverridden, LookStale, LookWithoutVolume, ResultChanged

The words of a rule's message are in the rule's file. Four rules repeat the error of a reader
instead, so that validating and stylizing give one reason:

- FieldFileMissing: `usd.values`, `vdb.header`
- GridMissing, GridUnsupported: `vdb.read`
- RequestInvalid: `usd.volume_requests`
"""

from usdsmoke.usd.rules.facts import Finding, Severity
from usdsmoke.usd.rules.staleness import switched_files, switched_variants, written_at
from usdsmoke.usd.rules.validation import (
    PREFIX,
    check_rules,
    mend,
    register_validators,
    validate,
)

__all__ = [
    "PREFIX",
    "Finding",
    "Severity",
    "check_rules",
    "mend",
    "register_validators",
    "switched_files",
    "switched_variants",
    "validate",
    "written_at",
]
