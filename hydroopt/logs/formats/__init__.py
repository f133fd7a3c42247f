"""Files of each format as sheets of columns: text tables, Parquet, MATLAB and those that a process of its own reads."""
