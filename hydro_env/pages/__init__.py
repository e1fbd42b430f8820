"""The look that the HTML pages share: one quiet style sheet, one frame, pictures that follow light and dark.

    html = render(files("hydro_env.experiments").joinpath("demo.html"), title="...", ...)

A template starts with `{% extends "page.html" %}` and fills the block `body`. Pages load nothing from a network. Whatever
text a page shows can neither end an element nor stand for another value: `render` escapes it, `fill` puts it in as JSON, and
each place of a template is filled once. All but `fill` needs the extra `report`.
"""

import html
import io
import json
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydro_env.errors import InputWarning, to_install
from hydro_env.files import write_bytes, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "COLOURS", "beside_results", "figure", "fill", "legend", "png", "render", "svg",
]  # fmt: skip

#: Line colours that can be told apart on white and on dark, also by most colour-blind eyes.
COLOURS = ("#2b83ba", "#e07b39", "#3f9b5f", "#a35aa8", "#8a8f98", "#c5a100")

#: Stands for the page's own text colour in an SVG until `svg` puts that in its place.
INK = "#123456"

#: Width of a figure, inches.
WIDTH = 8.6

#: Room for a row of a legend above axes, for numbers and a label below or for ticks alone, and on the right, inches.
ABOVE, BELOW, TICKS, RIGHT = 0.3, 0.45, 0.06, 0.1

RC: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "hydro_env",
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
}


@contextmanager
def beside_results(page: Path) -> Iterator[None]:
    """Makes a page or picture beside results that are written already: what fails in the block costs only that.

    An `InputWarning` says so, and so does a page, in the place of one that an earlier run may have left. A full disk is an
    error as anywhere.
    """
    try:
        yield
    except OSError:
        raise
    except Exception as problem:
        hint = f" ({to_install('report')})" if isinstance(problem, ModuleNotFoundError) else ""
        why = f"{page.name} could not be made: {type(problem).__name__}: {problem}{hint}; the results beside it are complete"
        warnings.warn(InputWarning(" ".join(why.split())), stacklevel=3)
        if page.suffix == ".html":
            write_text(page, f'<!doctype html><meta charset="utf-8"><p>{html.escape(why)}</p>\n')


def render(template: Path | Traversable, **values: Any) -> str:
    """Fills a Jinja template that extends `page.html`; values are escaped unless they are `Markup`."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("hydro_env.pages", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["style"] = files(__package__).joinpath("style.css").read_text(encoding="utf-8")
    return environment.from_string(template.read_text(encoding="utf-8")).render(**values)


def fill(template: Path | Traversable, **data: Any) -> str:
    """Fills a page that draws itself: `/*STYLE*/` becomes the style sheet, `/*NAME*/null` of its script the JSON of that value.

    The template is gone through once, so what is filled in is not searched for places to fill. KeyError for a place without
    a value.
    """

    def value(place: re.Match[str]) -> str:
        if place["name"] == "STYLE":
            return files(__package__).joinpath("style.css").read_text(encoding="utf-8")
        # "<" as an escape: no `</script>` can come from a text. Letters beyond ASCII are escapes as well.
        text = json.dumps(data[place["name"]], separators=(",", ":"), allow_nan=False)
        return text.replace("<", "\\u003c")

    return re.sub(r"/\*(?P<name>[A-Z]+)\*/(?:null)?", value, template.read_text(encoding="utf-8"))


def figure(rows: int = 1, *, height: float = 2.2, left: float | None = None) -> "tuple[Figure, list[Any]]":
    """A Matplotlib figure of page width with `rows` axes of `height` inches below each other, which share the axis along.

    Room for what stands around the axes is measured. Or there are `left` inches of it on the left, and elsewhere enough for a
    row of a legend above and a label below.
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context({**RC, **dict.fromkeys(_INKED, INK)}):
        made = Figure(figsize=(WIDTH, height * rows), layout="constrained" if left is None else None)
        if left is not None:
            whole, between = height * rows, ABOVE + TICKS
            each = (whole - ABOVE - BELOW - between * (rows - 1)) / rows
            ends = {"bottom": BELOW / whole, "top": 1.0 - ABOVE / whole}
            made.subplots_adjust(left / WIDTH, right=1.0 - RIGHT / WIDTH, **ends, hspace=between / each)
        axes = made.subplots(rows, sharex=True, squeeze=False)[:, 0]
    return made, list(axes)


_INKED = (
    "text.color", "axes.labelcolor", "axes.edgecolor", "axes.titlecolor", "grid.color", "xtick.color", "ytick.color",
    "xtick.labelcolor", "ytick.labelcolor",
)  # fmt: skip


def legend(axis: Any) -> None:
    """The legend of an axis in one row above it, where it covers no line."""
    columns = len(axis.get_legend_handles_labels()[1])
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.98), "borderaxespad": 0.0}
    axis.legend(ncols=columns, frameon=False, fontsize=8.5, labelcolor=INK, **place)


def svg(drawing: "Figure", alt: str) -> Any:
    """The figure as inline SVG (`Markup`) that takes its text colour and font from the page."""
    import matplotlib
    from markupsafe import Markup, escape

    buffer = io.StringIO()
    _as_written(drawing)
    with matplotlib.rc_context(RC):
        for ground in (drawing.patch, *(axis.patch for axis in drawing.axes)):
            ground.set_visible(False)
        drawing.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :].replace(INK, "currentColor")
    text = re.sub(
        r'<svg [^>]*viewBox="([^"]*)"[^>]*>',
        lambda opening: f'<svg viewBox="{opening[1]}" role="img" aria-label="{escape(alt)}">',
        text,
        count=1,
    )
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font-size: \1px", text)
    return Markup(text)


def _as_written(drawing: "Figure") -> None:
    """Shows all texts but the numbers at the axes as they are: a name with two "$" is not a formula."""
    from matplotlib.text import Text

    sides = [side for axis in drawing.axes for side in (axis.xaxis, axis.yaxis)]
    for text in {*drawing.findobj(Text)}.difference(*(side.get_ticklabels(which="both") for side in sides)):
        text.set_parse_math(False)


def png(drawing: "Figure", path: Path) -> None:
    """The figure as a PNG on white, for places that show no SVG."""
    import matplotlib
    from matplotlib.text import Text

    _as_written(drawing)
    with matplotlib.rc_context(RC):
        for text in drawing.findobj(Text):
            text.set_color("#1c2430")
        memory = io.BytesIO()
        drawing.savefig(memory, format="png", dpi=150, facecolor="white")
    write_bytes(path, memory.getvalue())
