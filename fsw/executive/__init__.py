"""Cyclic executive: schedule table, tick loop, timing statistics."""
