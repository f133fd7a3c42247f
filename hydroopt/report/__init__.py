"""Figures and one HTML page from an answer; draws and formats, computes nothing."""
