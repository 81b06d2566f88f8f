"""wingbeat: what every room of the house shares. Errors for people, the console, and the command line."""

__version__ = "0.1.0"
