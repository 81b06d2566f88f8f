"""Vision on cell grids: pure functions on arrays."""
