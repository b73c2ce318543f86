"""One HTML file that opens without a network: text, tables, pictures and curves that can be zoomed.

In come sections; out comes the page as text. plotly's script is carried in the file, compressed: as it
is it would take 4.8 MB, compressed 1.9 MB, and the browser unpacks it by itself.
"""

from __future__ import annotations

import base64
import gzip
import html
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError

_STYLE = """
:root { color-scheme: light dark; --ink: #1c2024; --ground: #ffffff; --faint: #6b7280; --line: #d5d9de;
  --good: #14804a; --bad: #c22f2f; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e8ea; --ground: #15181b; --faint: #9aa2ab;
  --line: #353b42; --good: #4ec58a; --bad: #ff7b72; } }
body { font: 15px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--ground);
  max-width: 62rem; margin: 1.5rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
table { border-collapse: collapse; } th, td { text-align: left; padding: .2rem .8rem .2rem 0;
  border-bottom: 1px solid var(--line); vertical-align: top; }
th { color: var(--faint); font-weight: 600; } pre { overflow-x: auto; padding: .6rem;
  border: 1px solid var(--line); } .good { color: var(--good); } .bad { color: var(--bad); }
.pictures { display: grid; grid-template-columns: 1fr 1fr; gap: .8rem; } figure { margin: 0; }
img { width: 100%; } .scroll { max-height: 22rem; overflow-y: auto; } .faint { color: var(--faint); }
"""

_LOADER = """
(async () => {
  const packed = document.getElementById('plotly').textContent;
  const bytes = Uint8Array.from(atob(packed), c => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
  const script = document.createElement('script');
  script.textContent = await new Response(stream).text();
  document.head.appendChild(script);
  for (const found of document.querySelectorAll('script[data-figure]')) {
    const figure = JSON.parse(found.textContent);
    Plotly.newPlot(found.dataset.figure, figure.data, figure.layout,
      {responsive: true, displaylogo: false});
  }
})();
"""

GREY = "#808790"
"""Text and axes of curves: told from a light and a dark ground alike."""
_GRID = "rgba(128,135,144,0.25)"
POINTS = 1500
"""Points of a curve; chosen as what a screen can show, with every extreme among them."""
_PACK_LEVEL = 9


def plotly() -> Any:
    """plotly's graph objects.

    Raises:
        InputError: It is not installed.
    """
    try:
        import plotly.graph_objects as objects
    except ImportError as error:
        raise InputError(
            "report: needs plotly; install it with: pip install 'ttc-workcell[report]'"
        ) from error
    return objects


class Page:
    """A page that is being written; every method adds a piece and escapes what it is given."""

    def __init__(self, title: str):
        self._title = title
        self._body: list[str] = [f"<h1>{html.escape(title)}</h1>"]
        self._figures = 0

    def heading(self, text: str) -> None:
        """A section begins."""
        self._body.append(f"<h2>{html.escape(text)}</h2>")

    def text(self, text: str, kind: str = "") -> None:
        """A paragraph; `kind` is `good`, `bad` or `faint`."""
        self._body.append(f'<p class="{kind}">{html.escape(text)}</p>')

    def code(self, text: str) -> None:
        """A command, as typed."""
        self._body.append(f"<pre>{html.escape(text)}</pre>")

    def table(
        self, head: Sequence[str], rows: Sequence[Sequence[str]], *, scroll: bool = False
    ) -> None:
        """A table; the words `yes` and `NO` are coloured."""
        marks = {"yes": "good", "NO": "bad"}
        lines = ["".join(f"<th>{html.escape(cell)}</th>" for cell in head)]
        lines += [
            "".join(f'<td class="{marks.get(cell, "")}">{html.escape(cell)}</td>' for cell in row)
            for row in rows
        ]
        table = "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"
        self._body.append(f'<div class="scroll">{table}</div>' if scroll else table)

    def pictures(self, pictures: Sequence[tuple[str, NDArray[np.uint8]]]) -> None:
        """Pictures (height, width, 3) with a line below each, two in a row."""
        found = []
        for caption, picture in pictures:
            data = base64.b64encode(_jpeg(picture)).decode()
            found.append(
                f'<figure><img alt="{html.escape(caption)}" src="data:image/jpeg;base64,{data}">'
                f"<figcaption>{html.escape(caption)}</figcaption></figure>"
            )
        self._body.append(f'<div class="pictures">{"".join(found)}</div>')

    def figure(self, figure: Any, height_px: int) -> None:
        """A plotly figure, which can be zoomed."""
        figure.update_layout(
            height=height_px,
            paper_bgcolor="rgba(0,0,0,0)",
            plot_bgcolor="rgba(0,0,0,0)",
            font={"color": GREY},
            margin={"l": 60, "r": 20, "t": 70, "b": 40},
            legend={"orientation": "h", "y": 1.025, "yanchor": "bottom"},
            template="none",
        )
        axis = {"gridcolor": _GRID, "zerolinecolor": _GRID, "linecolor": GREY}
        figure.update_xaxes(**axis)
        figure.update_yaxes(**axis)
        self._figures += 1
        name = f"figure{self._figures}"
        # A slash before a closing tag would end the script that holds the text.
        content = figure.to_json().replace("</", "<\\/")
        self._body.append(
            f'<div id="{name}"></div><script type="application/json" data-figure="{name}">'
            f"{content}</script>"
        )

    def write(self) -> str:
        """The whole page."""
        scripts = ""
        if self._figures:
            from plotly.offline import get_plotlyjs

            packed = gzip.compress(get_plotlyjs().encode(), _PACK_LEVEL, mtime=0)
            data = base64.b64encode(packed).decode()
            scripts = (
                f'<script id="plotly" type="text/plain">{data}</script><script>{_LOADER}</script>'
            )
        return (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width">'
            f"<title>{html.escape(self._title)}</title><style>{_STYLE}</style></head><body>"
            f"{''.join(self._body)}{scripts}</body></html>\n"
        )


def thinned(values: NDArray[np.float64], least: bool) -> tuple[NDArray[np.intp], NDArray[Any]]:
    """At most `POINTS` entries of a (T,) curve: of each stretch the one with the extreme that matters.

    Args:
        values: The curve; NaN where it has a gap.
        least: Whether a small value is the one that matters (times, distances) or a large one.

    Returns:
        Places of the entries and the entries, in single precision.
    """
    count = len(values)
    stretch = max(1, -(-count // POINTS))
    if stretch == 1:
        return np.arange(count), values.astype(np.float32)
    filler = np.inf if least else -np.inf
    padded = np.full(-(-count // stretch) * stretch, filler)
    padded[:count] = np.where(np.isnan(values), filler, values)
    by_stretch = padded.reshape(-1, stretch)
    chosen = by_stretch.argmin(axis=1) if least else by_stretch.argmax(axis=1)
    places = np.minimum(np.arange(len(by_stretch)) * stretch + chosen, count - 1)
    return places, values[places].astype(np.float32)


def css(colour: tuple[int, int, int]) -> str:
    """A colour as browsers write it."""
    return f"rgb{colour}"


def _jpeg(picture: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=82)
    return stream.getvalue()
