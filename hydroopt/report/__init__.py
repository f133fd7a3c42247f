"""Figures and one HTML page from an estimate; draws and formats, computes nothing."""
