"""Runs as others drive them: a dictionary in and one out, scans, a class of LUME. Each run is a process of its own."""
