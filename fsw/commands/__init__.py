"""Commands: from checked requests to what they do, and their answers."""
