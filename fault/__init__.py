"""Fault protection: limits, persistence, modes. Sees telemetry points only."""
