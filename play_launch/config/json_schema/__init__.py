"""The keys of the configuration as JSON Schema, for editors."""
