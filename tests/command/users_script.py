"""A user's script, which `make check` holds to the API's types; it is not run."""

from pathlib import Path

from pxr import Usd

import usdsmoke

plan = usdsmoke.plan("shot.usda", style=["a.png", "b.png"], settings={"optimize.iterations": 3})
n: int = plan.n_frames
result = usdsmoke.stylize(
    Usd.Stage.Open("shot.usda"), "a.png", Path("look"), {"optimize": {"iterations": 3}}, force=True
)
files: tuple[Path, ...] = result.frames
findings = [finding.message for finding in usdsmoke.validate("look/look.usda")]
changes = [change.kind for change in usdsmoke.verify("look/look.usda")]
page: Path = usdsmoke.report("shot.usda", "a.png", "report").page
names: list[str] = list(usdsmoke.settings())

# The types are known: without them there would be nothing to ignore, which mypy reports.
wrong: str = plan.n_frames  # type: ignore[assignment]
