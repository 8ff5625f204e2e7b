"""``python -m usdsmoke`` is the command ``usdsmoke``."""

import sys

from usdsmoke.cli import main

__all__: list[str] = []

if __name__ == "__main__":
    sys.exit(main())
