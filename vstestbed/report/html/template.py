"""HTML template and style sheet of the pages: one column on a phone, two on a desk, light or dark as the reader's system.

The page loads nothing from outside: no font, script or image, so that it opens the same without network and years later.
"""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path

# --ink and --rule are also the colours of the SVG figures (see `canvas.to_svg` and `chart.paint`).
STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #5b6470; --rule: #c3c9d1; --ground: #f4f5f7; --card: #ffffff; --good: #0a7f5a;
  --bad: #b3261e; --accent: #0068b3; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8eaed; --soft: #a2abb6; --rule: #4a525c; --ground: #14171b; --card: #1e2227;
  --good: #14946a; --bad: #c7423a; --accent: #6cb6f5; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink); font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1180px; margin: 0 auto; padding: 20px 16px 48px; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0 0 2px; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 34px 0 10px; }
p { margin: 4px 0; }
.soft, figcaption, dt small { color: var(--soft); }
.outcome { color: #fff; background: var(--bad); border-radius: 10px; padding: 16px 20px; margin: 16px 0; }
.outcome.good { background: var(--good); }
.outcome strong { display: block; font-size: 1.75rem; line-height: 1.2; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 10px; margin: 0; }
.tiles div, figure, details, .numbers { background: var(--card); border: 1px solid var(--rule); border-radius: 10px; }
.tiles div { padding: 10px 14px; }
.tiles dt { color: var(--soft); font-size: .85rem; }
.tiles dd { margin: 0; font-size: 1.45rem; font-weight: 600; font-variant-numeric: tabular-nums; white-space: nowrap; }
.tiles dd span { font-size: .95rem; font-weight: 400; color: var(--soft); }
.numbers { padding: 4px 14px; columns: 2 400px; column-gap: 40px; margin: 10px 0 0; }
.numbers div { display: flex; justify-content: space-between; gap: 16px; padding: 4px 0;
  break-inside: avoid; border-bottom: 1px solid var(--rule); }
.numbers div:last-child { border-bottom: 0; }
.numbers dt { color: var(--soft); }
.numbers dd { margin: 0; font-variant-numeric: tabular-nums; text-align: right; white-space: nowrap; }
.grid { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(440px, 100%), 1fr)); gap: 14px; align-items: start; }
.plots { columns: 2 400px; column-gap: 14px; }
.plots figure { margin-bottom: 14px; }
figure { margin: 0; padding: 12px 14px; break-inside: avoid; }
figure h3 { font-size: 1rem; margin: 0 0 6px; }
figure > svg, figure video { display: block; width: 100%; height: auto; }
figure svg text { font-family: inherit !important; }
figure video { border-radius: 6px; background: #000; }
figcaption { font-size: .85rem; line-height: 1.4; margin-top: 6px; }
.bar { display: flex; height: 22px; border-radius: 6px; overflow: hidden; background: var(--rule); }
.bar i { display: block; min-width: 1px; }
.key { display: flex; flex-wrap: wrap; gap: 4px 18px; margin: 8px 0 0; padding: 0; list-style: none; font-size: .9rem; }
.key svg { width: 20px; height: 9px; margin-right: .4em; }
.key i { display: inline-block; width: .75em; height: .75em; border-radius: 2px; margin-right: .45em; }
details { padding: 8px 14px; margin-top: 10px; }
summary { cursor: pointer; font-weight: 600; }
pre { overflow-x: auto; font: .82rem/1.45 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; margin: 8px 0 4px; }
a { color: var(--accent); }
@media (max-width: 480px) { main { padding: 14px 10px 32px; } figure { padding: 10px 8px; } .outcome strong { font-size: 1.4rem; }
  .tiles { grid-template-columns: 1fr 1fr; } .tiles dd { font-size: 1.2rem; } }
@media print { :root { --ink: #000; --soft: #444; --rule: #bbb; --ground: #fff; --card: #fff; --good: #0a7f5a; --bad: #b3261e; }
  body { font-size: 10pt; } main { max-width: none; padding: 0; }
  .outcome, .bar, .key i { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  .plots { columns: 2 80mm; } .films { display: none; } }
"""

# The empty icon keeps browsers from asking for /favicon.ico.
PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>{style}</style>
</head>
<body>
<main>
<header>
<h1>{heading}</h1>
{description}
</header>
{body}
</main>
</body>
</html>
"""


# HTML parts of the pages: cards with a figure, films, folded text.
def figure(title: str, content: str, caption: str = "") -> str:
    """A card with title, content (HTML) and caption."""
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure><h3>{escape(title)}</h3>{content}{below}</figure>"


def film(title: str, path: Path, embedded: bool) -> str:
    """A film with its controls, embedded in the page or linked to the file beside it."""
    source = data_url("video/mp4", path.read_bytes()) if embedded else escape(path.name)
    caption = "" if embedded else f'<figcaption>Beside this page: <a href="{source}">{source}</a></figcaption>'
    return f'<figure><h3>{escape(title)}</h3><video controls muted playsinline preload="metadata" src="{source}"></video>{caption}</figure>'


def picture(title: str, png: bytes) -> str:
    """A PNG picture, embedded in the page."""
    return f'<figure><h3>{escape(title)}</h3><img alt="{escape(title)}" style="width:100%" src="{data_url("image/png", png)}"></figure>'


def data_url(kind: str, content: bytes) -> str:
    """The content of a file as a `data:` URL of the given MIME type."""
    return f"data:{kind};base64," + base64.b64encode(content).decode("ascii")


def folded(title: str, text: str) -> str:
    """Preformatted text, folded under a title that opens it."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"


# A page inside a Jupyter notebook's cell.
def cell(page: str, height_px: int) -> str:
    """A whole HTML page as the output of a cell, in a frame of its own: its style sheet touches nothing of the notebook."""
    look = f"width:100%;height:{height_px}px;border:0;border-radius:10px"
    return f'<iframe srcdoc="{escape(page)}" style="{look}" sandbox="allow-scripts allow-popups"></iframe>'
