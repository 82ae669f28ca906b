"""A run, or a comparison of many, as one HTML page that needs nothing else: outcome, numbers, figures, films, provenance."""

from vstestbed.report.comparison_page import write_comparison_report
from vstestbed.report.page import render_page, write_report
from vstestbed.report.tracks import Setting

__all__ = ["Setting", "render_page", "write_comparison_report", "write_report"]
