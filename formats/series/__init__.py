"""Files of a time series."""
