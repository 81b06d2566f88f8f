"""Tasks: one file each, thin shells round the pure functions."""
