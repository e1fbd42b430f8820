"""A picture of a rig at work: both shafts, their speeds against the set-point, both commands; and a window for such pictures.

Needs the extra `render`.
"""

import math
from importlib import import_module
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from ..arrays import Floats, Integers, Picture
from ..errors import to_install

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw


#: Control periods that the picture shows.
SHOWN = 300
#: A picture is this many units wide and high; a unit is about the height of a line of text.
ACROSS, DOWN = 32, 24
#: It is drawn this many times larger, then reduced, so that lines are smooth.
FINER = 2
#: Range of the axis of the speeds on the paper's rig, rpm; where motors are faster it is a multiple of it.
MAX_RPM = 800.0

_WHITE, _GRID, _BLACK = "#ffffff", "#d8dade", "#303030"
_COLOURS = ("#1f6fb4", "#e8710a")  # motor and valve 1, 2
#: Columns of what is kept of each instant.
_SETPOINT, _SPEED, _COMMAND, _ANGLE = 0, (1, 2), (3, 4), (5, 6)
_KEPT = 7

#: Pictures of a window in a second: as many as the eye needs, and few enough for the simulation to keep up.
PICTURES = 25

Curve = tuple[Floats, str]


def _imported(module: str, why: str) -> Any:
    """A module of the extra `render`. DependencyNotInstalled where it is not there."""
    try:
        return import_module(module)
    except ImportError as problem:
        raise gymnasium.error.DependencyNotInstalled(f"{why}: {to_install('render')}") from problem


class Recorder:
    """The recent past of every rig: set-point and speeds in rpm, commands in V, shaft angles in rad."""

    def __init__(self, num_rigs: int, width: int, speed: float = 1.0) -> None:
        """`speed`: scale of the speeds (`Scales`)."""
        _imported("PIL", "pictures need Pillow")
        self._width, self._most = width, float(f"{MAX_RPM * speed:.1g}")
        self._past = np.full((num_rigs, SHOWN, _KEPT), np.nan)
        self._instants = np.zeros(num_rigs, np.int64)

    def clear(self, rows: Integers) -> None:
        """Forgets the past of some rows."""
        self._past[rows] = np.nan
        self._instants[rows] = 0

    def add(self, rows: Integers, true: Floats, angle: Floats) -> None:
        """Adds an instant of some rows, given the true signals (N, TRUE) and the shaft angles (N, 2) of all."""
        self._past[rows] = np.roll(self._past[rows], -1, axis=1)
        now = np.column_stack([true[:, 2], true[:, 0:2], true[:, 4:6], angle])
        self._past[rows, -1] = now[rows]
        self._instants[rows] += 1

    def picture(self, row: int, period: float, rated: float) -> Picture:
        """(3/4 width, width, 3): above, the shafts as they now stand, with speeds and commands in numbers; below, the last
        `SHOWN` control periods. `period` in s; `rated`, the rated command in V, is the range of the axis of the commands.
        """
        from PIL import Image, ImageDraw

        size = (FINER * self._width, FINER * self._width * DOWN // ACROSS)
        image = Image.new("RGB", size, _WHITE)
        page = _Page(ImageDraw.Draw(image), size[0] / ACROSS)
        past = self._past[row]
        now = np.nan_to_num(past[-1])
        for channel, colour in enumerate(_COLOURS):
            left = 1.0 + 15.5 * channel
            page.shaft(left + 3.2, 4.0, 3.2, now[_ANGLE[channel]], colour)
            page.text(left + 7.2, 2.2, f"motor {channel + 1}", colour)
            page.text(left + 7.2, 4.0, f"{now[_SPEED[channel]]:z.0f} rpm", colour)
            page.text(left + 7.2, 5.8, f"{now[_COMMAND[channel]]:z.1f} V", colour)
        page.text(1.0, 8.3, f"set-point {now[_SETPOINT]:z.0f} rpm", _BLACK)
        difference = now[_SPEED[0]] - now[_SPEED[1]]
        page.text(31.0, 8.3, f"difference {difference:z.0f} rpm", _BLACK, "rm")
        end = (self._instants[row] - 1) * period
        time = end + period * np.arange(1 - SHOWN, 1)
        speeds = [(past[:, _SETPOINT], _BLACK), *zip(past[:, _SPEED].T, _COLOURS, strict=True)]
        commands = list(zip(past[:, _COMMAND].T, _COLOURS, strict=True))
        fastest = float(np.nanmax(np.abs([values for values, _ in speeds]), initial=1.0))
        most = self._most * math.ceil(fastest / self._most)
        page.axes((10.9, 16.6), "speed, rpm", time, most, 0.5 * most, speeds)
        page.axes((18.6, 21.8), "command, V", time, rated, rated, commands)
        page.times(23.0, time)
        return np.array(image.reduce(FINER))


class Window:
    """A window that shows pictures of a rig as they are, in step with the clock. Closing it stops nothing but the pictures."""

    def __init__(self, title: str) -> None:
        self._pygame, self._title = _imported("pygame", "a window needs pygame"), title
        self._screen: Any = None
        self._clock = self._pygame.time.Clock()
        self._closed = False

    def show(self, picture: Picture, per_second: float) -> None:
        """Shows a picture (height, width, 3), at most `per_second` of them in a second."""
        if self._closed:
            return
        pygame = self._pygame
        if self._screen is None:
            pygame.display.init()
            self._screen = pygame.display.set_mode(picture.shape[1::-1])
            pygame.display.set_caption(self._title)
        pygame.surfarray.blit_array(self._screen, picture.swapaxes(0, 1))
        pygame.display.flip()
        self._clock.tick(per_second)
        if pygame.event.get(pygame.QUIT):
            self.close()
        else:
            pygame.event.pump()

    def close(self) -> None:
        """Closes it for good."""
        if self._screen is not None:
            self._pygame.display.quit()
        self._screen, self._closed = None, True


class _Page:
    """A drawing in units: shafts, text, axes with curves."""

    LEFT, RIGHT = 4.0, 31.0

    def __init__(self, draw: "ImageDraw", unit: float) -> None:
        from PIL import ImageFont

        self.draw, self.unit = draw, unit
        self.font = ImageFont.load_default(1.25 * unit)
        self.thin, self.thick = max(1, round(0.06 * unit)), max(1, round(0.16 * unit))

    def text(self, x: float, y: float, text: str, colour: str, anchor: str = "lm") -> None:
        self.draw.text((x * self.unit, y * self.unit), text, colour, self.font, anchor)

    def line(self, points: Floats, colour: str, width: int) -> None:
        self.draw.line([tuple(point) for point in points * self.unit], colour, width, joint="curve")

    def shaft(self, x: float, y: float, radius: float, angle: float, colour: str) -> None:
        """A shaft end with a mark that turns clockwise with positive speed."""

        def box(share: float) -> list[float]:
            r = share * radius
            return [side * self.unit for side in (x - r, y - r, x + r, y + r)]

        self.draw.ellipse(box(1.0), _GRID, colour, 2 * self.thick)
        mark = np.degrees(angle) % 360.0 - 90.0
        self.draw.pieslice(box(0.8), mark - 22.0, mark + 22.0, colour)
        self.draw.ellipse(box(0.25), _WHITE, colour, self.thick)

    def axes(
        self, span: tuple[float, float], title: str, time: Floats, most: float, tick: float, curves: list[Curve],
    ) -> None:  # fmt: skip
        """Curves over time between two heights, for values from -most to most, with a line every `tick`."""
        top, bottom = span
        middle, half = 0.5 * (top + bottom), 0.5 * (bottom - top)
        self.text(self.LEFT, top - 0.95, title, _BLACK)
        for level in np.arange(-(most // tick), most // tick + 1) * tick:
            y = middle - half * level / most
            self.line(np.array([[self.LEFT, y], [self.RIGHT, y]]), _BLACK if level == 0 else _GRID, self.thin)
            if level in (0.0, tick, -tick):
                self.text(self.LEFT - 0.3, y, f"{level:z.3g}", _BLACK, "rm")
        for instant in _seconds(time):
            x = self.across(instant, time)
            self.line(np.array([[x, top], [x, bottom]]), _GRID, self.thin)
        for values, colour in curves:
            seen = ~np.isnan(values)
            if seen.sum() > 1:
                y = middle - half * np.clip(values[seen] / most, -1.0, 1.0)
                self.line(np.column_stack([self.across(time[seen], time), y]), colour, self.thick)

    def times(self, y: float, time: Floats) -> None:
        """Numbers and title of the axis of time."""
        for instant in _seconds(time):
            x = self.across(instant, time)
            if x < self.RIGHT - 5.0:
                self.text(x, y, f"{instant:g}", _BLACK, "mm")
        self.text(self.RIGHT, y, "time, s", _BLACK, "rm")

    def across(self, instant: Any, time: Floats) -> Any:
        """Where instants (a number or an array) of the axis of time lie."""
        return self.LEFT + (self.RIGHT - self.LEFT) * (instant - time[0]) / (time[-1] - time[0])


def _seconds(time: Floats) -> Floats:
    """Instants of the episode at which the axis of time has a line: about one a third of it."""
    step = 10.0 ** np.floor(np.log10(time[-1] - time[0]))
    ticks = np.arange(np.ceil(max(time[0], 0.0) / step), np.floor(time[-1] / step + 1e-9) + 1) * step
    return np.round(ticks, 9)
