"""The arguments of the commands that read records."""

import argparse
from collections.abc import Callable

_FILE = "a look layer, a stage or asset with looks, a VDB file of a result, or the output folder"


def add_record_commands(add: Callable[[str, str], argparse.ArgumentParser]) -> None:
    """Add ``provenance``, ``verify`` and ``rerun`` to the parser."""
    parser = add("provenance", "show how a result was made, and from which inputs")
    parser.add_argument("file", metavar="FILE", help=_FILE)
    parser.add_argument("--prov", action="store_true", help="print W3C PROV-JSON")
    parser = add("verify", "report what has changed since a result was made")
    parser.add_argument("file", metavar="FILE", help=_FILE)
    parser = add("rerun", "repeat a run from its provenance record")
    parser.add_argument("file", metavar="FILE", help=_FILE)
    parser.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="the folder for the new result"
    )
    parser.add_argument(
        "--force",
        action="store_true",
        help="accept inputs that have changed, and replace any result in OUT",
    )
