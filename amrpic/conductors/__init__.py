"""Conductors on a mesh: which cells lie in metal, and where arms between cell centres meet it."""
