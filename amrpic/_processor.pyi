def sets() -> list[str]:
    """Those of the x86-64 instruction sets v4, v3, v2 that this processor has, fastest first."""

def slowed_by_wide_vectors() -> bool:
    """Whether v4 is no faster than v3 here."""
