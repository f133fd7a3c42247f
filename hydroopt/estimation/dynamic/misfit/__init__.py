"""Whether residuals are what noise and smoothing explain, and which fault of instruments or model they show."""
