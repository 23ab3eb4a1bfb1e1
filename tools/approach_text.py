"""Text and symbols drawn into an image at random, to fit mode approach to what is no runway.

Other kinds than `approach_views.TEXTS`, which are left for checks.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont

Pixels = NDArray[Any]
WORDS = (
    'ALT SPD HDG RPM BAT GPS LAT LON REC LIVE CAM FT KT M/S VSI PITCH ROLL HOME WP DIST SAT ARM '
    'MODE AUTO FLAPS GEAR DOWN ILS DME QNH UTC www.flightcam.tv Final Approach Runway channel HD'
)
COLOURS = np.array(
    [(255, 255, 255)] * 5
    + [(0, 255, 255), (80, 255, 80), (0, 255, 0), (255, 255, 0), (0, 0, 255), (0, 165, 255)]
    + [(0, 0, 0), (220, 220, 220)]
)
"""Blue, green, red."""
FONTS = sorted(
    path
    for path in Path(mpl.get_data_path(), 'fonts', 'ttf').glob('*.ttf')
    if path.name.startswith(('DejaVu', 'STIXGeneral', 'cmtt', 'cmss', 'cmr'))
)


def burned_in(image: Pixels, seed: int) -> Pixels:
    """A copy with lines of text, symbols of a head-up display, or both."""
    random, image = np.random.default_rng(seed), image.copy()
    kind = random.integers(4)
    for _ in range(random.integers(1, 4) if kind in (2, 3) else 0):
        _symbol(image, random)
    for _ in range(random.integers(0, 4) if kind == 2 else random.integers(2, 10)):
        _line_of_text(image, random)
    return image


def _colour(image: Pixels, random: np.random.Generator) -> Any:
    colour = COLOURS[random.integers(len(COLOURS))]
    return (*colour.tolist(),) if image.ndim == 3 else int(colour @ (0.114, 0.587, 0.299))


def _words(random: np.random.Generator) -> str:
    def part() -> str:
        kind = random.integers(3)
        if kind == 0:
            return str(random.choice(WORDS.split()))
        if kind == 1:
            return f'{random.uniform(0, 2000):.{random.integers(3)}f}'
        return ':'.join(f'{random.integers(60):02d}' for _ in range(3))

    return ' '.join(part() for _ in range(random.integers(1, 5)))


def _line_of_text(image: Pixels, random: np.random.Generator) -> None:
    """Plain, outlined, or in a box that hides what is behind it wholly or in part."""
    height, width = image.shape[:2]
    words, colour, style = _words(random), _colour(image, random), random.integers(4)
    font = ImageFont.truetype(str(random.choice(FONTS)), int(random.uniform(16, 38) * width / 640))
    _, top, right, bottom = font.getbbox(words)
    x = int(min(random.uniform(0.01, 0.8) * width, max(0, width - right - 2)))
    share = random.choice([random.uniform(0.03, 0.25), random.uniform(0.75, 0.98), random.random()])
    y = int(np.clip(share * height - bottom, 0, height - bottom))
    if style >= 2:
        rows = slice(max(y + int(top) - 3, 0), y + int(bottom) + 3)
        part = image[rows, max(x - 3, 0) : x + int(right) + 3]
        share = 1.0 if style == 2 else random.uniform(0.4, 0.8)
        part[:] = (1 - share) * part + share * random.choice([0, 0, 40, 255])
    page = PillowImage.fromarray(image)
    outline = {'stroke_width': 1, 'stroke_fill': 0 if image.ndim == 2 else (0, 0, 0)}
    more: dict[str, Any] = outline if style == 1 else {}
    ImageDraw.Draw(page).text((x, y), words, font=font, fill=colour, **more)
    image[:] = np.asarray(page)


def _symbol(image: Pixels, random: np.random.Generator) -> None:
    """A cross, a circle, a ladder, tapes with scales, brackets, rectangles, or a horizon bar."""
    height, width = image.shape[:2]
    colour, thick = _colour(image, random), max(1, round(random.uniform(1, 2.5) * width / 640))
    middle = np.array([0.5 * width, random.uniform(0.35, 0.6) * height])

    def line(first: Any, last: Any) -> None:
        ends = (tuple(np.rint(end).astype(int).tolist()) for end in (first, last))
        cv2.line(image, *ends, colour, thick, cv2.LINE_AA)

    def low() -> float:
        return random.uniform(0.05, 0.4)

    def high() -> float:
        return random.uniform(0.6, 0.95)

    kind, angle = random.integers(7), random.uniform(-0.3, 0.3)
    along = np.array([math.cos(angle), math.sin(angle)])
    down = np.array([-along[1], along[0]])
    if kind == 0:
        for way in (along, -along, down, -down):
            line(middle + 0.01 * width * way, middle + random.uniform(0.02, 0.08) * width * way)
    elif kind == 1:
        step, long = random.uniform(0.06, 0.12) * height, random.uniform(0.08, 0.2) * width
        for number in range(-3, 4):
            for way in (along, -along):
                inner, outer = (middle + number * step * down + d * way for d in (0.3 * long, long))
                line(inner, outer)
                line(outer, outer + 8 * down)
    elif kind == 2:
        for x in (low() * width, high() * width):
            rows = np.arange(0.2 * height, 0.8 * height, random.uniform(6, 16) * height / 360)
            line((x, rows[0]), (x, rows[-1]))
            for number, y in enumerate(rows):
                line((x, y), (x + (10 if number % 5 else 18) * width / 640, y))
    elif kind == 3:
        for x, inwards in ((low(), 1), (high(), -1)):
            for y, downwards in ((low(), 1), (high(), -1)):
                corner = np.array([x * width, y * height])
                for way in np.diag([inwards, downwards]):
                    line(corner, corner + 0.05 * width * way)
    elif kind == 4:
        first = random.uniform(0, 0.8, 2) * (width, height)
        last = first + random.uniform(0.04, 0.3, 2) * (width, height)
        places = (tuple(place.astype(int).tolist()) for place in (first, last))
        cv2.rectangle(image, *places, colour, thick)
    elif kind == 5:
        # Around the middle, or small with wings and a fin, where the aircraft flies to.
        middle += random.uniform(-0.12, 0.12, 2) * (width, height)
        radius = width * random.choice([random.uniform(0.01, 0.03), random.uniform(0.03, 0.1)])
        place = tuple(np.rint(middle).astype(int).tolist())
        cv2.circle(image, place, round(radius), colour, thick, cv2.LINE_AA)
        for way in (along, -along, -down) if random.integers(3) else ():
            line(middle + radius * way, middle + random.uniform(1.6, 2.6) * radius * way)
    else:
        for way in (along, -along):
            line(middle + 0.05 * width * way, middle + 0.25 * width * way)
