"""Drivers behind the hardware abstraction, one file each."""
