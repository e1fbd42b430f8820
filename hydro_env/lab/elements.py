"""Parts of the page that NiceGUI lacks: turning shafts, sliders that say their value in words, a field for large files, plots."""

import time
from collections.abc import Callable
from typing import Any

from nicegui import ui
from nicegui.element import Element

from hydro_env.arrays import Floats
from hydro_env.lab.session import COLUMNS, SHOWN
from hydro_env.lab.uploads import MAX_BYTES, YAML_ENDINGS
from hydro_env.lab.worker import Seen
from hydro_env.measured.formats import ENDINGS
from hydro_env.pages import COLOURS
from hydro_env.units import RPM

#: Seconds after its last move until a slider is at rest.
AT_REST = 1.0


def quiet_button(text: str, on_click: Callable[[], Any], name: str = "") -> ui.button:
    """A button with an outline; `name` is what a screen reader calls it, where the text does not say it alone."""
    button = ui.button(text, on_click=on_click, color=None).props("outline")
    if name:
        button.props["aria-label"] = name
    return button


class Motors(Element, component="motors.js"):
    """Both shafts as they turn, with speeds, commands, set-point and difference in numbers."""

    def show(self, seen: Seen) -> None:
        """Shows the newest state."""
        pace = RPM * seen.reached if seen.running else 0.0
        self.run_method("show", {"angle": seen.session.angle, "pace": pace, **seen.session.now})


class SlidingNumber(Element, component="slider.js"):
    """A slider with a label and its value in `words`; `moved` is called with each new position. `group` stands before the label
    for who does not see what the slider stands below. Unlike that of `ui.slider`, its position is the browser's: no late answer
    of the server moves it under the hand."""

    def __init__(self, label: str, ends: tuple[int, int], start: int, words: Callable[[int], str],
                 moved: Callable[[int], None], group: str = "") -> None:  # fmt: skip
        super().__init__()
        self._moved_at = 0.0
        least, most = ends
        self._props |= {"label": label, "group": group, "least": least, "most": most, "start": start}
        self.say(words(start))

        def handle(position: float) -> None:
            self._moved_at = time.monotonic()
            self.say(words(int(position)))
            moved(int(position))

        self.on("moved", lambda event: handle(event.args), throttle=0.05)

    @property
    def at_rest(self) -> bool:
        """Whether nobody is moving it, so that it may be placed."""
        return time.monotonic() - self._moved_at > AT_REST

    def say(self, text: str) -> None:
        """Puts the value in words."""
        self.props["text"] = text

    def place(self, position: int, text: str) -> None:
        """Moves the slider."""
        self.run_method("place", position)
        self.say(text)


class Drop(Element, component="drop.js"):
    """A field for files, which go to `/upload`. `sent` is called when all are there, `refused` with a line for each other."""

    def __init__(self, label: str, sent: Callable[[], object], refused: Callable[[str], object]) -> None:
        super().__init__()
        accepted = ",".join((*ENDINGS, ".gz", *YAML_ENDINGS))
        self._props |= {"label": label, "accept": accepted, "most": MAX_BYTES}
        self.on("sent", lambda: sent())
        self.on("refused", lambda event: refused(str(event.args)))


#: Rows of a snapshot per row drawn.
EVERY = 2
_GREY = "#8a8f98"


class Plots(ui.echart):
    """Speeds with set-point, difference and commands over the last seconds."""

    def __init__(self) -> None:
        super().__init__(_options(), renderer="canvas")
        shown = "speeds and set-point, speed difference and commands over the last ten seconds"
        self.props(f'role="img" aria-label="{shown}"')

    def show(self, seen: Seen) -> None:
        """Draws the past of a snapshot."""
        past = seen.session.past
        self.draw(past[(len(past) - 1) % EVERY :: EVERY])

    def draw(self, past: Floats) -> None:
        """Draws rows (n, len(COLUMNS))."""
        rows = past.round(2).tolist()
        end = rows[-1][0] if rows else SHOWN * 0.01
        span = {"min": round(end - SHOWN * 0.01, 2), "max": end}
        self.run_chart_method("setOption", {"dataset": {"source": rows}, "xAxis": [span] * 3})


def _options() -> dict[str, Any]:
    """Three panels with one axis of time; set-point and commands are held from row to row. Motor 2 is dashed, so that no
    curve is told by its colour alone."""
    tops, heights = ("7%", "46%", "73%"), ("30%", "18%", "18%")
    titles = ("speed, rpm", "difference, rpm", "command, V")
    curves = (
        (0, 1, "set-point", _GREY, "dotted", True), (0, 2, "motor 1", COLOURS[0], "solid", False),
        (0, 3, "motor 2", COLOURS[1], "dashed", False), (1, 4, "difference", COLOURS[3], "solid", False),
        (2, 5, "command 1", COLOURS[0], "solid", True), (2, 6, "command 2", COLOURS[1], "dashed", True),
    )  # fmt: skip
    axis = {"axisLabel": {"color": _GREY}, "nameTextStyle": {"color": _GREY, "align": "left"}}
    lines = {"splitLine": {"lineStyle": {"color": _GREY, "opacity": 0.25}}}
    return {
        "animation": False,
        "dataset": {"dimensions": list(COLUMNS), "source": []},
        "legend": {"data": ["set-point", "motor 1", "motor 2"], "top": 0, "right": 4, "itemGap": 8, "itemWidth": 22,
                   "textStyle": {"color": _GREY}},
        "grid": [{"top": t, "height": h, "left": 52, "right": 14} for t, h in zip(tops, heights, strict=True)],
        "xAxis": [
            {"type": "value", "gridIndex": n, "min": 0, "max": SHOWN * 0.01, **axis, "splitLine": {"show": False},
             "axisLabel": {"color": _GREY, "show": n == 2, "showMinLabel": False, "showMaxLabel": False},
             "name": "time, s" if n == 2 else "", "nameLocation": "middle", "nameGap": 22}
            for n in range(3)
        ],
        "yAxis": [
            {"type": "value", "gridIndex": n, "name": titles[n], "nameGap": 8, "splitNumber": 3, **axis, **lines}
            for n in range(3)
        ],
        "series": [
            {"type": "line", "name": name, "xAxisIndex": panel, "yAxisIndex": panel, "showSymbol": False, "silent": True,
             "encode": {"x": 0, "y": column}, "lineStyle": {"width": 1.6, "type": kind, "color": colour},
             "itemStyle": {"color": colour}, "step": "end" if held else False}
            for panel, column, name, colour, kind, held in curves
        ],
    }  # fmt: skip
