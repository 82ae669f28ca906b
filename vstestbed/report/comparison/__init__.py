"""The report of a comparison: tables, statistics, figures, the page."""
