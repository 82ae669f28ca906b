"""Pieces that pages are put together from: figures, films, folded text."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path


def figure(title: str, content: str, caption: str = "") -> str:
    """A card with a title, content (HTML) and a caption below it."""
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f"<figure><h3>{escape(title)}</h3>{content}{below}</figure>"


def film(title: str, path: Path, inside: bool) -> str:
    """A film with its controls: inside the page, or as a link to the file beside it."""
    source = data_url("video/mp4", path.read_bytes()) if inside else escape(path.name)
    caption = "" if inside else f'<figcaption>Beside this page: <a href="{source}">{source}</a></figcaption>'
    return f'<figure><h3>{escape(title)}</h3><video controls muted playsinline preload="metadata" src="{source}"></video>{caption}</figure>'


def data_url(kind: str, content: bytes) -> str:
    """A file of a MIME kind as an address that holds it."""
    return f"data:{kind};base64," + base64.b64encode(content).decode("ascii")


def folded(title: str, text: str) -> str:
    """Text as it is, behind a title that opens it."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"
