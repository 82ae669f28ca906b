"""HTML parts of the pages: cards with a figure, films, folded text."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path


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
