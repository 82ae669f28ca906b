"""HTML parts that all pages share: figures as SVG, the page template, cards, films."""
