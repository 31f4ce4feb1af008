"""Exact answers that tests, the tables of the verification and benchmarks share: sources, meshes, orbits, channels, …"""
