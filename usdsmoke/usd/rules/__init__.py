"""Checks of volumes that USD's own validators do not make, as validators in USD's own registry.

`registry` tells UsdValidation about them, `run` runs them with all others on a file. The rules
stand in `field_rules` (one field), `volume_rules` (a Volume's fields together), `request_rules`
(what a Volume asks for) and `result_rules` (files that usdsmoke wrote); `facts` collects what they
look at.
"""

from usdsmoke.usd.rules.findings import Finding, Severity
from usdsmoke.usd.rules.registry import PREFIX, register_validators
from usdsmoke.usd.rules.run import validate, validate_stage

__all__ = ["PREFIX", "Finding", "Severity", "register_validators", "validate", "validate_stage"]
