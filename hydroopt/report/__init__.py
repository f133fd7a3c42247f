"""Figures and one HTML page from an estimate; draws and formats, computes nothing."""

from hydroopt.matplotlib_import import import_matplotlib

import_matplotlib()
