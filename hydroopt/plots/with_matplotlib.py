"""Import this before matplotlib: figures ignore the settings in the working directory."""

from hydroopt.matplotlib_import import import_matplotlib

import_matplotlib()
