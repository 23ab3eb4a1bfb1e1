"""Forms that several figures of the thesis share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from mvuav_ros.offline.report_figures import Canvas, drawing, label, legend_below


@contextmanager
def quartet(
    titles: Sequence[str], height: float, x: str, y: str, *, sharey: bool = True, columns: int = 6
) -> Iterator[tuple[Canvas, list[Axes]]]:
    """Two rows of two panels with their titles, axis labels outside, and one legend below."""
    with drawing(9.6, height) as canvas:
        grid = canvas.figure.subplots(2, 2, sharex=True, sharey=sharey)
        for axes, title in zip(grid.flat, titles, strict=True):
            label(axes, title)
        yield canvas, list(grid.flat)
        for axes in grid[-1]:
            axes.set_xlabel(x)
        for axes in grid[:, 0]:
            axes.set_ylabel(y)
        legend_below(canvas.figure, *grid.flat, columns=columns)


def plain_log(axes: Axes) -> None:
    """A logarithmic y axis whose labels are ordinary numbers."""
    axes.set_yscale('log')
    axes.yaxis.set_major_locator(LogLocator(10, subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
    axes.yaxis.set_minor_formatter(NullFormatter())
