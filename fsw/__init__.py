"""The flight application: the same in simulation, on the flatsat and on board."""
