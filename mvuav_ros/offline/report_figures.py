"""How all figures look."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mvuav_ros.offline import report

mpl.use('Agg')

INK, SOFT, GRID = '#1c2430', '#5b6675', '#d5dbe3'
COLORS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9', '#6a4c93', '#8c6d31')
"""Okabe and Ito's, distinguished also without colour vision."""
TRUTH, THESIS = INK, '#b3261e'
_DPI = 150


def line_of(number: int) -> dict[str, Any]:
    """Colour and dashes of the n-th curve; dashed where the colours begin again."""
    return {
        'color': COLORS[number % len(COLORS)],
        'ls': ('-', '--', ':')[number // len(COLORS) % 3],
    }


_RC: Any = {
    # What a user has named is no formula.
    'text.parse_math': False,
    'font.family': 'DejaVu Sans',
    'font.size': 9.5,
    'axes.titlesize': 10.0,
    'axes.titleweight': 'bold',
    'axes.labelcolor': INK,
    'axes.edgecolor': SOFT,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'axes.formatter.useoffset': False,
    'axes.grid': True,
    'axes.axisbelow': True,
    'axes.prop_cycle': cycler(color=COLORS),
    'grid.color': GRID,
    'grid.linewidth': 0.6,
    'text.color': INK,
    'xtick.color': SOFT,
    'ytick.color': SOFT,
    'xtick.labelcolor': INK,
    'ytick.labelcolor': INK,
    'lines.linewidth': 1.3,
    'legend.fontsize': 8.5,
    'legend.frameon': True,
    'legend.framealpha': 0.92,
    'legend.edgecolor': GRID,
    'figure.facecolor': 'white',
    'axes.facecolor': 'white',
}


class Canvas:
    """A figure being drawn; ``png`` holds it afterwards."""

    def __init__(self, figure: Figure) -> None:
        self.figure = figure
        self.png = b''

    def as_figure(self, key: str, title: str, alt: str, *notes: str) -> report.Figure:
        """What was drawn, for a report; ``alt`` says what it shows."""
        return report.Figure(key, title, self.png, alt, notes)


@contextmanager
def drawing(width: float = 9.6, height: float = 3.8) -> Iterator[Canvas]:
    """Draw a figure of that size (inches): within, on ``figure``; after, it is in ``png``."""
    with mpl.rc_context(_RC):
        canvas = Canvas(Figure(figsize=(width, height), layout='constrained'))
        yield canvas
        buffer = io.BytesIO()
        with warnings.catch_warnings():
            # Letters that the font lacks are boxes.
            warnings.filterwarnings('ignore', 'Glyph')
            # Without the drawing library's advertisement, the same data give the same bytes.
            canvas.figure.savefig(buffer, dpi=_DPI, format='png', metadata={'Software': None})
        canvas.png = buffer.getvalue()


def label(axes: Axes, title: str = '', x: str = '', y: str = '') -> None:
    """Title and axis labels; each label names its unit."""
    if title:
        axes.set_title(title, loc='left')
    axes.set_xlabel(x)
    axes.set_ylabel(y)


Residuals = tuple[Any, Any, str, str]
"""Pixels (n, 2), their residuals (n, 2), px; colour, and name, which may be empty."""


def residual_figure(
    title: str,
    size: tuple[int, int],
    deviation: float,
    residuals: Iterable[Residuals],
    alt: str,
    meaning: str,
) -> report.Figure:
    """Residuals as arrows over an image of that size, px.

    Those of three times the ``deviation`` are a twenty-fifth of the width long.
    ``alt`` says what the figure shows, ``meaning`` what arrows show that agree.
    """
    width, height = size
    scale = 0.04 * width / max(3.0 * deviation, 1e-9)
    with drawing(9.6, 9.6 * height / width + 0.4) as canvas:
        axes = canvas.figure.add_subplot()
        for pixels, errors, color, name in residuals:
            arrows: Any = {'angles': 'xy', 'scale_units': 'xy', 'scale': 1.0, 'width': 0.0012}
            axes.quiver(*pixels.T, *(errors * scale).T, color=color, label=name, **arrows)
        axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect='equal')
        label(axes, '', 'u [px]', 'v [px]')
        if axes.get_legend_handles_labels()[1]:
            legend_below(canvas.figure, axes)
    note = f'Arrows are seen minus projected, {scale:.0f} times as long as in the image. They '
    note += 'should point anywhere: arrows that agree with their neighbours show '
    return canvas.as_figure('residuals', title, alt, note + meaning)


def legend_below(figure: Figure, *panels: Axes, columns: int = 6) -> None:
    """One legend of what the panels show, below all of them, where it hides nothing."""
    handles: dict[str, Any] = {}
    for axes in panels:
        handles |= {
            name: handle for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)
        }
    try:
        figure.legend(handles.values(), handles.keys(), loc='outside lower center', ncols=columns)
    except ValueError:
        # matplotlib 3.6, which Ubuntu 24.04 has, cannot make room for a legend by itself.
        rows = -(-len(handles) // columns)
        room = (0.1 + 0.22 * rows) / figure.get_figheight()
        figure.set_layout_engine('constrained', rect=(0.0, room, 1.0, 1.0 - room))
        figure.legend(handles.values(), handles.keys(), loc='lower center', ncols=columns)
