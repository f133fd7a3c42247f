"""Measured signals: reading logs, finding and treating their defects, smooth motion from samples."""
