"""Reports: a run or a comparison as one self-contained HTML page with outcome, numbers, figures, films, provenance."""

from vstestbed.report.comparison.page import write_comparison_report
from vstestbed.report.run.page import render_page, write_report
from vstestbed.report.run.tracks import Setting

__all__ = ["Setting", "render_page", "write_comparison_report", "write_report"]
