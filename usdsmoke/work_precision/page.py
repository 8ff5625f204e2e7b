"""One HTML file with everything in it: no script, no font, nothing from anywhere else."""

import base64
from collections.abc import Mapping
from html import escape

from usdsmoke.work_precision.records import Figures, Point, Report, Spread, SweepResult

__all__ = ["make_page", "number"]

_STYLE = """
body { font: 15px/1.5 system-ui, "DejaVu Sans", sans-serif; color: #1c1c1c; background: #fff;
       max-width: 1020px; margin: 2em auto; padding: 0 1.5em; }
h1 { font-size: 1.7em; margin-bottom: .2em; } h2 { font-size: 1.25em; margin-top: 2.2em;
     border-top: 1px solid #ddd; padding-top: 1em; }
p.about { color: #444; } p.verdict { background: #eef5f8; border-left: 4px solid #0b6e99;
     padding: .6em .9em; } figure { margin: 1em 0; } img { max-width: 100%; height: auto; }
table { border-collapse: collapse; font-size: .88em; margin: .6em 0; }
th, td { text-align: left; padding: .2em .9em .2em 0; border-bottom: 1px solid #eee;
     vertical-align: top; } td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
tr.configured td { font-weight: 600; } details { margin: .6em 0; } summary { cursor: pointer;
     color: #0b6e99; } dl.facts { display: grid; grid-template-columns: max-content 1fr;
     gap: .1em 1.2em; font-size: .92em; } dl.facts dt { color: #666; } dl.facts dd { margin: 0; }
ul.curves li { margin: .25em 0; } .contents { columns: 2; }
"""


def make_page(report: Report, pictures: Mapping[str, bytes]) -> str:
    """The report as HTML.

    Args:
        report: what it says.
        pictures: a PNG file's bytes by the sweep's name.
    """
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(report.title)}</title>",
        f"<style>{_STYLE}</style>",
        "</head>",
        "<body>",
        f"<h1>{escape(report.title)}</h1>",
        "<p>What each choice around the configured ones gains and costs, for this scene. Every "
        "point is the median of several runs, bars reach from the least to the largest; the ring "
        "marks what is configured. Lower and further to the left is better.</p>",
        *_summary(report),
        *(_facts(part) for part in report.facts[:1]),
        *_notes(report),
    ]
    for result in report.sweeps:
        parts += _sweep(result, pictures[result.name])
    parts += _omissions(report)
    parts += [_facts(part) for part in report.facts[1:]]
    parts += ["</body>", "</html>"]
    return "\n".join(parts) + "\n"


def _summary(report: Report) -> list[str]:
    rows = [
        f'<li><a href="#{escape(result.name)}">{escape(result.title)}</a>: '
        f"{escape(result.verdict)}</li>"
        for result in report.sweeps
    ]
    left_out = f'<li><a href="#omissions">Omissions</a>: {len(report.omissions)}</li>'
    return ['<h2 id="short">In short</h2>', "<ul>", *rows, left_out, "</ul>"]


def _facts(figures: Figures) -> str:
    rows = "\n".join(
        f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in figures.rows
    )
    name = escape(figures.title)
    return f'<h2 id="{name.lower()}">{name}</h2>\n<dl class="facts">\n{rows}\n</dl>'


def _notes(report: Report) -> list[str]:
    return [f'<p class="about">{escape(note)}</p>' for note in report.notes]


def _sweep(result: SweepResult, picture: bytes) -> list[str]:
    plan = result.plan
    image = base64.b64encode(picture).decode("ascii")
    sentences = [
        f"<li><b>{escape(curve)}</b>: {escape(text)}</li>"
        for curve, text in result.sentences.items()
    ]
    missing = f"Points that did not fit the time: {escape('; '.join(result.missing))}."
    return [
        f'<section id="{escape(result.name)}">',
        f"<h2>{escape(result.title)}</h2>",
        f'<p class="verdict">{escape(result.verdict)}</p>',
        f'<p class="about">{escape(plan.about)}</p>',
        f'<figure><img alt="{escape(result.title)}: {escape(plan.y_label)} against '
        f'{escape(plan.x_label)}" src="data:image/png;base64,{image}"></figure>',
        '<ul class="curves">',
        *sentences,
        "</ul>",
        f'<p class="about"><b>Reference:</b> {escape(plan.reference)}</p>',
        *(f'<p class="about">{escape(note)}</p>' for note in plan.notes),
        *([f'<p class="about">{missing}</p>'] if result.missing else []),
        *_table(result),
        "</section>",
    ]


def _table(result: SweepResult) -> list[str]:
    names = [
        ("curve", ""), ("point", ""), ("error", "n"), ("least to largest", "n"),
        (result.plan.y_label, "n"), ("least to largest", "n"), ("CPU s", "n"), ("wall s", "n"),
        ("runs", "n"),
    ]  # fmt: skip
    head = "".join(f'<th class="{kind}">{escape(name)}</th>' for name, kind in names)
    rows = [_row(point) for points in result.curves.values() for point in points]
    return [
        f"<details><summary>{len(rows)} {'point' if len(rows) == 1 else 'points'} in figures"
        "</summary>",
        f"<table><thead><tr>{head}</tr></thead><tbody>",
        *rows,
        "</tbody></table></details>",
    ]


def _row(point: Point) -> str:
    label = f"{point.label} (configured)" if point.configured else point.label
    numbers = [
        number(point.error.median), _range(point.error), number(point.cost.median),
        _range(point.cost), number(point.cpu.median), number(point.wall.median),
        str(point.n_runs),
    ]  # fmt: skip
    cells = "".join(f'<td class="n">{text}</td>' for text in numbers)
    kind = ' class="configured"' if point.configured else ""
    return f"<tr{kind}><td>{escape(point.curve)}</td><td>{escape(label)}</td>{cells}</tr>"


def number(value: float) -> str:
    """A figure of the tables.

    >>> number(0.0012345), number(0.0), number(123456.0)
    ('0.00123', '0', '123,456')
    """
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _range(spread: Spread) -> str:
    return f"{number(spread.low)} to {number(spread.high)}"


def _omissions(report: Report) -> list[str]:
    rows = [
        f"<li><b>{escape(item.what)}</b>: {escape(item.reason)}.</li>" for item in report.omissions
    ]
    return ['<section id="omissions">', "<h2>Omissions</h2>", "<ul>", *rows, "</ul>", "</section>"]
