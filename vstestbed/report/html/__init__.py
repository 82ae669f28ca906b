"""Pieces of HTML that all pages share: canvas of a figure, template, tables."""
