"""Fault protection: failures, limits, modes, validity. Sees telemetry points only."""
