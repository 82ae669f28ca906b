"""Reports: a run or a comparison as one self-contained HTML page with outcome, numbers, figures,
films, provenance.

The page of a comparison is written by `comparison.page.write_comparison_report`. Pages are jinja2
templates (`templates/`).
"""

from vstestbed.report.run.page import render_page, write_report
from vstestbed.report.run.tracks import Setting

__all__ = ["Setting", "render_page", "write_report"]
