"""A page inside a Jupyter notebook's cell."""

from __future__ import annotations

from html import escape


def cell(page: str, height_px: int) -> str:
    """A whole HTML page as the output of a cell, in a frame of its own: its style sheet touches nothing of the notebook."""
    look = f"width:100%;height:{height_px}px;border:0;border-radius:10px"
    return f'<iframe srcdoc="{escape(page)}" style="{look}" sandbox="allow-scripts allow-popups"></iframe>'
