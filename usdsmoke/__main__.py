"""``python -m usdsmoke`` is the command ``usdsmoke``."""

import sys

from usdsmoke.ui.cli.main import main

__all__: list[str] = []

if __name__ == "__main__":
    sys.exit(main())
