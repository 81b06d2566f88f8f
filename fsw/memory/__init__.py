"""Memory that is taken once: frame pools and ring buffers."""
