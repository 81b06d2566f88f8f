"""Hardware abstraction: camera, trigger, clock, bus, store."""
