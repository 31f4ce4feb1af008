"""The life of a run, whatever its method: its folder, log, status, clock, and how it is stopped."""
