"""No launch files in XML and YAML."""
