"""Detectors: from a picture to the pixels of markers."""
