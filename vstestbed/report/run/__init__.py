"""The report of one run: figures, numbers, the page."""
