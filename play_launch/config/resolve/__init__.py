"""From the YAML tree to the resolved configuration; problems go to the report."""
