"""What a video says in words: slot, rates and QoS of every user, sum rate and the panels' phases."""

import colorsys
import itertools
import math
from collections.abc import Sequence

import matplotlib.font_manager
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mjris.show.palette import BLOCKED, CLEAR, rgb, user_colour
from mjris.show.rollout import Rollout

Picture = NDArray[np.uint8]

_PAPER = (27, 34, 43)
_INK = (245, 247, 250)
_FAINT = (150, 160, 172)
_GAP = 0.7
"""Between panels, in sides of an element."""


def phase_rgb(phase_rad: float) -> tuple[float, float, float]:
    """The hue of a phase [rad], once round the circle in 2π: red, green and blue in [0, 1]."""
    return colorsys.hsv_to_rgb(phase_rad / (2 * math.pi) % 1, 0.75, 1.0)


class Overlay:
    """The column beside the office: words above, the rover from close by below them, and the legend."""

    def __init__(self, rollout: Rollout, panel_sizes: Sequence[tuple[int, int]], width: int, height: int):
        """`panel_sizes` are rows and columns of all panels, `width` and `height` [px] those of the column."""
        self._rollout = rollout
        self._panel_sizes = panel_sizes
        self._size = (width, height)
        users = rollout.rates_bps.shape[1]
        self._em = min(width / 15, height / (1.5 * (users + 20)))
        self._line = 1.5 * self._em
        self._inset_top = round(self._em + (users + 8.3) * self._line)
        self._legend_top = round(height - 2.4 * self._line)
        self._font = _font("DejaVu Sans", self._em)
        self._bold = _font("DejaVu Sans:bold", self._em)
        self._drawn_slot: int | None = None
        self._drawn: Picture
        """Words of the slot that was drawn last: they stay for many frames."""

    @property
    def inset_size(self) -> tuple[int, int]:
        """Width and height of the picture in the column [px]."""
        return self._size[0], self._legend_top - self._inset_top

    def draw(self, slot: int, inset: Picture) -> Picture:
        """The column [height, width, 3] of a slot, with a picture of `inset_size`."""
        if slot != self._drawn_slot:
            image = Image.new("RGB", self._size, _PAPER)
            draw = ImageDraw.Draw(image)
            self._rates(draw, slot)
            self._legend(draw)
            self._drawn_slot, self._drawn = slot, np.asarray(image)
        column = self._drawn.copy()
        column[self._inset_top : self._legend_top] = inset
        return column

    def _rates(self, draw: ImageDraw.ImageDraw, slot: int) -> None:
        em, line, rollout = self._em, self._line, self._rollout
        left, right, y = em, self._size[0] - em, em
        draw.text((left, y), f"Slot {slot + 1} of {rollout.slots}", _INK, self._bold)
        y += 1.3 * line
        for user in range(rollout.rates_bps.shape[1]):
            draw.ellipse((left, y + 0.15 * em, left + em, y + 1.15 * em), rgb(user_colour(user)))
            draw.text((left + 1.5 * em, y), f"User {user + 1}", _INK, self._font)
            draw.text((right - 1.6 * em, y), in_words(rollout.rates_bps[slot, user]), _INK, self._font, anchor="ra")
            met = rollout.qos_met[slot, user]
            mark, colour = ("✓", CLEAR) if met else ("✗", BLOCKED)
            draw.text((right, y), mark, rgb(colour), self._bold, anchor="ra")
            y += line
        y += 0.3 * line
        draw.text((left, y), "Sum", _INK, self._bold)
        draw.text((right - 1.6 * em, y), in_words(rollout.sum_rate_bps[slot]), _INK, self._bold, anchor="ra")
        y += 1.2 * line
        self._sparkline(draw, slot, (left, y, right, y + 1.6 * line))
        y += 2.1 * line
        self._phases(draw, slot, (left, y, right, y + 2.3 * line))

    def _sparkline(self, draw: ImageDraw.ImageDraw, slot: int, box: tuple[float, float, float, float]) -> None:
        """The sum rate so far, on the scale of the whole episode from zero."""
        left, top, right, bottom = box
        rate = self._rollout.sum_rate_bps
        height = (bottom - top) / max(rate.max(), 1)
        step = (right - left) / max(len(rate) - 1, 1)
        points = [(left + t * step, bottom - rate[t] * height) for t in range(slot + 1)]
        draw.line((left, bottom, right, bottom), _FAINT)
        draw.line(points, _INK, max(1, round(self._em / 8)))
        x, y = points[-1]
        r = self._em / 5
        draw.ellipse((x - r, y - r, x + r, y + r), rgb(CLEAR))

    def _phases(self, draw: ImageDraw.ImageDraw, slot: int, box: tuple[float, float, float, float]) -> None:
        """The panels seen from their fronts, the rover's on the left, each element in the hue of its phase."""
        left, top, right, bottom = box
        draw.text((left, (top + bottom) / 2), "Phases", _INK, self._font, anchor="lm")
        wide, high = sum(cols for _, cols in self._panel_sizes), max(rows for rows, _ in self._panel_sizes)
        gaps = _GAP * (len(self._panel_sizes) - 1)
        side = min((bottom - top) / high, (right - left) * 0.6 / (wide + gaps))
        left = right - (wide + gaps) * side
        phases = iter(self._rollout.phases_rad[slot])
        for rows, cols in self._panel_sizes:
            for row, col in itertools.product(range(rows), range(cols)):
                red, green, blue = (round(255 * part) for part in phase_rgb(next(phases)))
                # Elements are counted from the bottom, and to the left as the panel is seen.
                x, y = left + (cols - 1 - col) * side, bottom - (row + 1) * side
                edge = min(1.5, side / 4)
                draw.rectangle((x, y, x + side - edge, y + side - edge), (red, green, blue))
            left += (cols + _GAP) * side

    def _legend(self, draw: ImageDraw.ImageDraw) -> None:
        em = self._em
        for row, (colour, words) in enumerate(((CLEAR, "line of sight"), (BLOCKED, "blocked"))):
            y = self._legend_top + (0.7 + row) * self._line
            draw.line((em, y, 3 * em, y), rgb(colour), max(2, round(em / 4)))
            draw.text((3.8 * em, y), words, _INK, self._font, anchor="lm")


def in_words(rate_bps: float) -> str:
    """A rate in the unit that suits it, with three digits or so."""
    for unit, bps in (("Gb/s", 1e9), ("Mb/s", 1e6)):
        if rate_bps >= bps:
            return f"{rate_bps / bps:.{2 if rate_bps < 10 * bps else 1 if rate_bps < 100 * bps else 0}f} {unit}"
    return f"{rate_bps / 1e3:,.0f} kb/s"


def _font(name: str, size: float) -> ImageFont.FreeTypeFont:
    """A font by its name; matplotlib brings DejaVu along."""
    return ImageFont.truetype(matplotlib.font_manager.findfont(name), size)
