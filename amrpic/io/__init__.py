"""Files of a run: checkpoints, field dumps and the time series."""
