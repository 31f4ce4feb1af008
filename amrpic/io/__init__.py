"""Files of a run: checkpoints, fields (VTKHDF), particles (openPMD) and the time series."""
