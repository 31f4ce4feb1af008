"""Lattices that other codes describe, as elements of a scene: read, laid out along the orbit, and converted."""
