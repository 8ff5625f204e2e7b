"""Checks of volumes that USD's own validators do not make.

- `validation`: registers the rules with UsdValidation; runs all validators over a stage
- `findings`: what a rule or a validator finds
- `facts`: a Volume's fields over time, and the headers of their files
- `field_rules`: rules on one field
- `volume_rules`: rules on a Volume's fields together, and on its style request
- `result_rules`: rules on files that usdsmoke wrote
"""

from usdsmoke.usd.rules.findings import Finding, Severity
from usdsmoke.usd.rules.validation import PREFIX, register_validators, validate

__all__ = ["PREFIX", "Finding", "Severity", "register_validators", "validate"]
