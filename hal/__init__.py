"""Hardware abstraction: camera, trigger, clock, bus, link, store, watchdog."""
