"""Benches: methods side by side in one run, against closed forms, bounds and independent peers."""
