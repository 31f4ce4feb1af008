"""Space charge as an element of tracking codes: one module each, which imports its host where it must."""
