"""Modal identification: pure functions on arrays."""
