"""Tables: schema, validation and loading of configuration."""
