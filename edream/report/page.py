"""One self-contained page: figures, tables and text through a template, the same bytes for the same content."""

import base64
import io
import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure as Canvas
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, NullFormatter

SVG_LIMIT = 300_000  # bytes; a larger drawing becomes a bitmap
# Colours that stand for roles. Inside the page each becomes a CSS variable, so that it suits light and dark.
INK, GRID, COMMAND, MEASURED, PUBLISHED, BEFORE, AFTER = "#1b1e24", "#dfe3ea", "#9aa3b2", "#1b1e25", "#8a6fc1", "#d9602b", "#1a7fc4"
ROLES = {
    INK: "ink",
    GRID: "grid",
    COMMAND: "command",
    MEASURED: "measured",
    PUBLISHED: "published",
    BEFORE: "before",
    AFTER: "after",
}
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "text.parse_math": False,  # a joint may be called $x
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": COMMAND,
    "axes.labelsize": 9.5,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "lines.linewidth": 1.4,
    "path.simplify_threshold": 0.5,
}


@dataclass(frozen=True)
class Figure:
    """A drawing with its words.

    Attributes:
        name: unique within a page.
        title: what is drawn.
        caption: one sentence: what to see.
        drawing: inline SVG, or an image with its bytes in it.
        wide: as wide as the page, rather than half of it.
    """

    name: str
    title: str
    caption: str
    drawing: Markup
    wide: bool = False


def draw(
    name: str, title: str, caption: str, plot: Callable[[Canvas], None], size: tuple[float, float] = (5.6, 3.0), wide: bool = False
) -> Figure:
    """Draw a figure.

    Args:
        plot: draws on the empty canvas that it is given.
        size: width and height [inch].
    """
    with rc_context({**STYLE, "svg.hashsalt": name}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)  # the browser has the fonts that names need
        canvas = Canvas(
            figsize=size, layout=ConstrainedLayoutEngine(w_pad=0.09, h_pad=0.05)
        )  # browsers draw text a little wider than is measured here
        plot(canvas)
        text = io.StringIO()
        canvas.savefig(text, format="svg", dpi=160, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
        drawing = _inline(text.getvalue(), name, title)
        if len(drawing.encode()) > SVG_LIMIT:
            drawing = _bitmap(canvas, title)
    return Figure(name, title, caption, drawing, wide)


def log_scale(axis: Any) -> None:
    """A logarithmic y axis whose numbers are plain text: a page cannot set powers of ten."""
    axis.set_yscale("log")
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())


def _inline(svg: str, name: str, title: str) -> Markup:
    """A drawing as part of a page: own names for its parts, the page's colours, as wide as there is room."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    prefix = re.sub(r"[^A-Za-z0-9]+", "-", name)
    svg = re.sub(r'(<[^>]* id=")', rf"\1{prefix}-", svg)
    svg = re.sub(r"url\(#", f"url(#{prefix}-", svg)
    svg = re.sub(r'href="#', f'href="#{prefix}-', svg)
    for colour, role in ROLES.items():
        svg = re.sub(rf"(fill|stroke): {colour}\b", rf"\1: var(--{role})", svg)
    svg = re.sub(r"font: ([^;\"]*?)'DejaVu Sans'[^;\"]*", r"font: \1'DejaVu Sans', Verdana, sans-serif", svg)
    head = re.sub(r' (width|height|version)="[^"]*"', "", svg[: svg.index(">")])
    return Markup(f'{head} role="img" aria-label="{Markup.escape(title)}"') + Markup(svg[svg.index(">") :])


def _bitmap(canvas: Canvas, title: str) -> Markup:
    data = io.BytesIO()
    canvas.savefig(data, format="png", dpi=160, facecolor="white", metadata={"Software": None})
    return Markup('<img class="paper" alt="{}" src="data:image/png;base64,{}">').format(
        title, base64.b64encode(data.getvalue()).decode()
    )


def picture(name: str, title: str, caption: str, png: bytes) -> Figure:
    """An image as it is."""
    source = base64.b64encode(png).decode()
    return Figure(name, title, caption, Markup('<img alt="{}" src="data:image/png;base64,{}">').format(title, source))


def page(template: str, content: Mapping[str, Any]) -> str:
    """Fill a template of this folder. All text is escaped: names of motions and joints come from strangers."""
    environment = Environment(
        loader=PackageLoader("edream", "report"), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"number": number, "mrad": mrad, "share": share, "diff_class": diff_class, "short": short, "unit": unit}
    return environment.get_template(template).render(**content)


def number(value: float | None, interval: Sequence[float] | None = None) -> str:
    """A number with the digits that its interval leaves meaning to; three where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    width = abs(interval[1] - interval[0]) / 2 if interval else 0.0
    if width <= 0.0 or not math.isfinite(width):
        return _trimmed(f"{value:.3g}")
    decimals = 1 - math.floor(math.log10(width))
    if abs(value) < 1e-4 and width < 1e-3:
        return f"{value:.2g}"
    return f"{value:.{min(max(decimals, 0), 6)}f}"


def _trimmed(text: str) -> str:
    return f"{float(text):,.0f}" if "e+" in text else text


def mrad(value: float | None) -> str:
    """Radians as milliradians with sane digits."""
    return (
        "–"
        if value is None or not math.isfinite(value)
        else f"{value * 1e3:.{0 if abs(value) >= 0.1 else 1 if abs(value) >= 0.01 else 2}f}"
    )


def share(value: float | None) -> str:
    """A share as a percentage."""
    return "–" if value is None or not math.isfinite(value) else f"{100 * value:.0f} %".replace("-", "−")


def short(text: str, most: int = 28) -> str:
    """A name that fits on an axis: one line, no control characters, its middle left out where it is long."""
    clean = "".join(c if c.isprintable() else " " for c in str(text))
    return clean if len(clean) <= most else f"{clean[: most // 2 - 1]}…{clean[-(most - most // 2) :]}"


def unit(text: str) -> str:
    """A unit as it is printed."""
    return text.replace("^2", "²").replace("^3", "³")


def diff_class(line: str) -> str:
    """How a line of a difference is coloured."""
    if line.startswith(("---", "+++", "@@")):
        return "head"
    return {"+": "plus", "-": "minus"}.get(line[:1], "same")
