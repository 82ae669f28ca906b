"""A run as one HTML page that needs nothing else: outcome, numbers, figures, films, scenario."""

from vstestbed.report.page import render_page, write_report
from vstestbed.report.tracks import Setting

__all__ = ["Setting", "render_page", "write_report"]
