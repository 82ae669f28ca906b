"""HTML template, style sheet and parts of the pages, which load nothing from outside: the same without network and years later."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Sequence
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

TABLES = """
.outcome.open { background: #55606c; }
.outcome ul { margin: 8px 0 0; padding-left: 1.2em; }
.wide { overflow-x: auto; background: var(--card); border: 1px solid var(--rule); border-radius: 10px; margin: 8px 0; }
table { border-collapse: collapse; width: 100%; font-size: .84rem; font-variant-numeric: tabular-nums; }
th, td { padding: 6px 7px; text-align: right; vertical-align: top; border-top: 1px solid var(--rule); font-weight: 400; }
thead th { border-top: 0; vertical-align: bottom; font-size: .78rem; }
th:first-child { text-align: left; min-width: 9.5em; overflow-wrap: break-word; }
tbody th { font-weight: 600; }
td small { font-size: .76rem; display: block; color: var(--soft); white-space: nowrap; }
td { white-space: nowrap; }
.real { color: var(--accent); }
th button { all: unset; cursor: pointer; color: var(--soft); line-height: 1.25; }
th button:hover, th button:focus-visible { text-decoration: underline; }
th[aria-sort=ascending] button::after { content: " ▲"; } th[aria-sort=descending] button::after { content: " ▼"; }
select { font: inherit; }
.plan { display: grid; grid-template-columns: max-content 1fr; gap: 2px 18px; }
.plan dt { color: var(--soft); } .plan dd { margin: 0; overflow-wrap: anywhere; }
.failure summary .soft { font-weight: 400; }
.broad { margin-top: 14px; }
.gallery { display: grid; grid-template-columns: repeat(auto-fill, minmax(200px, 1fr)); gap: 10px; margin-top: 10px; }
.gallery img { display: block; width: 100%; height: auto; border-radius: 6px; }
.runs { margin: 6px 0; padding-left: 1.2em; font-size: .88rem; }
code { font: .82rem/1.45 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; overflow-wrap: anywhere; }
@media print { .outcome.open { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  .wide { overflow: visible; } table { font-size: 7pt; } }
"""

# The page must work from a file:// address without network: the script is inline and uses no library.
SCRIPT = """<script>
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending", key = row => row.cells[column].dataset.value;
    const number = text => text !== "" && isFinite(text);
    heads.forEach(other => other.setAttribute("aria-sort", other !== head ? "none" : down ? "descending" : "ascending"));
    const order = (a, b) => number(a) && number(b) ? a - b : a.localeCompare(b, undefined, { numeric: true });
    [...body.rows].sort((one, two) => {
      const a = key(one), b = key(two);
      return a === "" || b === "" ? (a === "") - (b === "") : (down ? -1 : 1) * order(a, b);
    }).forEach(row => body.append(row));
  }));
}
const reference = document.getElementById("reference");
if (reference) {
  const show = () => document.querySelectorAll(".against").forEach(part => { part.hidden = part.dataset.reference !== reference.value; });
  reference.addEventListener("change", show);
  show();
}
</script>"""

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


def page(heading: str, body: Iterable[str], description: str = "", title: str = "", style: str = STYLE + TABLES) -> str:
    """A whole page; title (as a rule the heading) and heading are text, all else is HTML, empty parts of the body are left out."""
    title, content = escape(title or heading), "\n".join(filter(None, body))
    return PAGE.format(title=title, style=style, heading=escape(heading), description=description, body=content)


def made_by(command: str) -> str:
    """The section with the command that repeats a study; empty without one."""
    return f"<section><h2>How it was made</h2><p>Made again by<br><code>{escape(command)}</code></p></section>" if command else ""


Cell = tuple[float | str | None, str]  # sort key of a table cell (None sorts last), and its HTML


def table(heads: Sequence[str], lines: Sequence[Sequence[Cell]]) -> str:
    """A table whose column heads are buttons that sort it; each cell carries its sort key as `data-value`."""
    top = "".join(f'<th scope="col" aria-sort="none"><button type="button">{escape(h)}</button></th>' for h in heads)
    body = "".join(f"<tr>{''.join(_cell(c, i) for i, c in enumerate(line))}</tr>" for line in lines)
    return f'<div class="wide"><table class="sortable"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _cell(cell: Cell, place: int) -> str:
    key, content = cell
    # nine digits: values that differ only beyond the shown ones still sort
    value = "" if key is None else escape(str(key) if isinstance(key, str | int) else f"{key:.9g}")
    return f'<th scope="row" data-value="{value}">{content}</th>' if place == 0 else f'<td data-value="{value}">{content}</td>'


def plain_table(heads: Sequence[str], lines: Iterable[Sequence[str]], named: bool = True) -> str:
    """A table that does not sort; heads are text, cells are HTML, the first of a line is its name if `named`."""
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    first = '<th scope="row">{}</th>' if named else "<td>{}</td>"
    rows = (first.format(line[0]) + "".join(f"<td>{cell}</td>" for cell in line[1:]) for line in lines)
    return (
        f'<div class="wide"><table><thead><tr>{top}</tr></thead><tbody>{"".join(f"<tr>{row}</tr>" for row in rows)}</tbody></table></div>'
    )


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


def number(value: object) -> str:
    """A number with three significant figures, as HTML: fixed point where that is short, else a power of ten; a dash if unknown."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "–" if value is None else escape(str(value))
    if isinstance(value, int):
        return str(value)
    if not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.2e}".split("e")
        return f"{mantissa}·10<sup>{int(exponent)}</sup>"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))  # three significant figures
    return f"{value:.{digits}f}"


def plain(value: object) -> str:
    """As `number`, without HTML, for text that is escaped as a whole: `1.23·10^-7`."""
    return number(value).replace("<sup>", "^").replace("</sup>", "")


# A page inside a Jupyter notebook's cell.
def cell(page: str, height_px: int) -> str:
    """A whole HTML page as the output of a cell, in a frame of its own: its style sheet touches nothing of the notebook."""
    look = f"width:100%;height:{height_px}px;border:0;border-radius:10px"
    return f'<iframe srcdoc="{escape(page)}" style="{look}" sandbox="allow-scripts allow-popups"></iframe>'
