"""One task for each container and process; each owns its state and carries out core's decisions."""
