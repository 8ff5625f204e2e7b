"""What a result says about how it was made: read, verified, made again, exported as PROV.

``record`` finds and reads records. ``verification`` compares a result with its record, ``inputs``
what it was made from. ``repetition`` makes it again. ``prov`` exports records as W3C PROV.

Reading a record loads USD and nothing else that is heavy: names are looked up when they are used.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from usdsmoke.audit.inputs import Change
    from usdsmoke.audit.prov import prov_document
    from usdsmoke.audit.record import FoundRecord, find_records, provenance
    from usdsmoke.audit.repetition import Rerun, rerun
    from usdsmoke.audit.verification import verify

__all__ = [
    "Change",
    "FoundRecord",
    "Rerun",
    "find_records",
    "prov_document",
    "provenance",
    "rerun",
    "verify",
]

_HOME = {
    "Change": "inputs",
    "FoundRecord": "record",
    "Rerun": "repetition",
    "find_records": "record",
    "prov_document": "prov",
    "provenance": "record",
    "rerun": "repetition",
    "verify": "verification",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
