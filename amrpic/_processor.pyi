def sets() -> list[str]:
    """Those of the x86-64 instruction sets v4, v3, v2 that this processor has, best first."""
