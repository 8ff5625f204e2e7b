"""Rules on what a Volume asks for itself: it counts, and it can be read."""

from pxr import Usd, UsdValidation, UsdVol

from usdsmoke.usd.rules.findings import Problem, Severity
from usdsmoke.usd.schema import STYLE_API
from usdsmoke.usd.volume_requests import has_request, ignored_attributes, request_problems

__all__ = ["check_request", "check_request_applied", "check_request_placed"]


def check_request(
    volume: Usd.Prim, _time_range: UsdValidation.ValidationTimeRange
) -> list[Problem]:
    """Requests are known to the schema, of the right type, in range, and lead somewhere."""
    problems = request_problems(volume)
    return [Problem(Severity.ERROR, path, message) for path, message in problems.items()]


def check_request_applied(
    volume: Usd.Prim, _time_range: UsdValidation.ValidationTimeRange
) -> list[Problem]:
    """Attributes of a request stand on a prim with the API applied; they do not count otherwise."""
    ignored = ignored_attributes(volume)
    if not ignored:
        return []
    message = f"{STYLE_API} is not applied, so that {', '.join(ignored)} do not count; apply it"
    return [Problem(Severity.WARN, str(volume.GetPath()), message)]


def check_request_placed(
    prim: Usd.Prim, _time_range: UsdValidation.ValidationTimeRange
) -> list[Problem]:
    """The API is applied to Volumes; on a prim of another type nobody reads it."""
    if not has_request(prim) or prim.IsA(UsdVol.Volume):
        return []
    kind = prim.GetTypeName() or "none"
    message = (
        f"{STYLE_API} is applied to a prim of type {kind}, where it does not count; wanted a "
        "Volume: apply it there"
    )
    return [Problem(Severity.WARN, str(prim.GetPath()), message)]
