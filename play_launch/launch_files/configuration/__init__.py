"""Records of launch files as a configuration: one that a person could have written."""
