"""The report as one HTML file: no script, no font, nothing from anywhere else."""

import base64
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from usdsmoke.work_precision.records import Report
from usdsmoke.work_precision.verdict import ratio_text


def make_page(report: Report, pictures: Mapping[str, bytes]) -> str:
    """The report as HTML, from the template ``page.html.j2``.

    Args:
        pictures: a PNG file's bytes by the sweep's name.
    """
    images = {name: base64.b64encode(data).decode("ascii") for name, data in pictures.items()}
    text: str = _template().render(report=report, images=images)
    return text


def number(value: float) -> str:
    """A number for the tables.

    >>> number(0.0012345), number(0.0), number(123456.0)
    ('0.00123', '0', '123,456')
    """
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _ratio(value: float, configured: float) -> str:
    return ratio_text(value / configured) if configured > 0 else "-"


@cache
def _template() -> Any:
    import jinja2

    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(number=number, ratio=_ratio)
    text = Path(__file__).with_name("page.html.j2").read_text(encoding="utf-8")
    return environment.from_string(text)
