"""Diagrams of points that a logarithm cannot take: no warning, and no number that is untrue."""

import io
from dataclasses import replace

import pytest
from PIL import Image

from tests.fixtures.report_fixtures import point, result_of
from usdsmoke.work_precision.page import draw_sweep
from usdsmoke.work_precision.records import Point, Spread

EXACT = point("float", "0", 0.0, 100.0, configured=True)
ROUGH = point("half", "0", 3e-3, 50.0)
NOISY = replace(ROUGH, error=Spread(0.2, 0.0, 0.3))
AT_ONCE = replace(ROUGH, cost=Spread(0.0, 0.0, 0.1))


@pytest.mark.parametrize(
    "points", [[EXACT], [EXACT, ROUGH], [NOISY], [AT_ONCE], [EXACT, AT_ONCE, NOISY]]
)
def test_points_at_0_are_drawn_without_a_warning(points: list[Point]) -> None:
    with Image.open(io.BytesIO(draw_sweep(result_of(points, uncertain=1e-3)))) as picture:
        assert picture.width > 600


def test_the_axis_has_no_number_where_exact_points_are(monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.figure import Figure

    seen: list[list[str]] = []
    save = Figure.savefig

    def look(figure: Figure, *args: object, **more: object) -> None:
        figure.canvas.draw()
        axes = figure.axes[0]
        seen.append([t.get_text() for t in axes.get_xticklabels() if t.get_text()])
        low = axes.transData.transform((3e-3 / 5**0.5, 1))[0]
        labels = [(t.get_text(), axes.transData.transform((t.get_position()[0], 1))[0])
                  for t in axes.get_xticklabels()]  # fmt: skip
        assert all(not text or place >= low for text, place in labels)
        save(figure, *args, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(Figure, "savefig", look)
    draw_sweep(result_of([EXACT, ROUGH]))
    assert seen[0]
    monkeypatch.setattr(
        Figure, "savefig",
        lambda figure, *args, **more: (
            figure.canvas.draw(),
            seen.append([t.get_text() for t in figure.axes[0].get_xticklabels()]),
            save(figure, *args, **more),
        ),
    )  # fmt: skip
    draw_sweep(result_of([EXACT]))
    assert seen[-1] == ["0"]
